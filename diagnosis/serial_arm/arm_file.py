"""TOML files of serial arms: strict reading, which reports every problem with its line, and writing."""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import Any, Final

from diagnosis.serial_arm.arm import Link, Repeatability, SerialArm, Uncertainty
from ground.common.errors import BadRequest
from sim.scenario.names import did_you_mean
from sim.scenario.toml_lines import NotToml, parse_toml
from sim.scenario.toml_record import Findings, read_record
from sim.scenario.toml_tables import list_tables

LINKS: Final = "link"
MOST_LINKS: Final = 20


class BadArmFile(BadRequest):
    """Error: a file does not describe an arm; one line of the message for each problem."""


@dataclass(frozen=True, slots=True)
class _Head:
    """Content of a file apart from its links."""

    name: str
    gravity_B_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    repeatability: Repeatability = field(default_factory=Repeatability)


def arm_from_toml(text: str, file: str) -> SerialArm:
    """Read an arm from TOML.

    Args:
        text: Content of the file.
        file: Name of the file in messages.

    Returns:
        The arm.

    Raises:
        BadArmFile: The file is wrong; the message lists every problem with its line.
    """
    try:
        data, lines = parse_toml(text)
    except NotToml as error:
        raise BadArmFile(f"{file}:{error.line}: {error}") from error
    findings = Findings(lines)
    head = read_record(_Head, {k: v for k, v in data.items() if k != LINKS}, (), findings)
    links = [read_record(Link, table, place, findings) for place, table in list_tables(data, LINKS, findings)]
    _check_links([one for one in links if one is not None], bool(data.get(LINKS)), findings)
    if head is None or findings.problems:
        raise BadArmFile("\n".join(f"{file}:{p.line}: {p.text}" for p in sorted(findings.problems)))
    found = tuple(one for one in links if one is not None)
    return SerialArm(head.name, found, head.gravity_B_m_s2, head.uncertainty, head.repeatability)


def arm_to_toml(arm: SerialArm, about: Iterable[str]) -> str:
    """Format an arm as TOML, from which every bit can be read again.

    Args:
        arm: Arm to write.
        about: Comments at the top of the file.

    Returns:
        The content of the file.
    """
    lines = [f"# {line}".rstrip() for line in about]
    lines += [
        "",
        f"name = {_toml_value(arm.name)}",
        f"gravity_B_m_s2 = {_toml_value(arm.gravity_B_m_s2)}",
        "",
    ]
    for one in arm.links:
        lines += ["[[link]]", *_fields(one), ""]
    for name, record in (("uncertainty", arm.uncertainty), ("repeatability", arm.repeatability)):
        lines += [f"[{name}]", *_fields(record), ""]
    return "\n".join(lines)


def _check_links(links: list[Link], is_given: bool, findings: Findings) -> None:
    if not is_given:
        findings.report(
            (), "link: is missing; write [[link]] and its keys below, once for each from the base"
        )
    if len(links) > MOST_LINKS:
        findings.report(("link",), f"link: there are {len(links)}; an arm has at most {MOST_LINKS} here")
    names = [one.name for one in links]
    for k, name in enumerate(names):
        if name in names[:k] or name in ("base", "target"):
            findings.report(("link", k), f"name: {name!r} is taken already; give each link its own")


def unknown_words(words: Iterable[str], known: Iterable[str], what: str) -> str | None:
    """Describe the first unknown word; None if all are known."""
    names = tuple(known)
    wrong = next((word for word in words if word not in names), None)
    return None if wrong is None else f"{what}: {wrong!r:.60} is not known; {did_you_mean(wrong, names)}"


def _fields(record: Any) -> list[str]:
    values = ((f.name, getattr(record, f.name)) for f in fields(record))
    return [f"{name} = {_toml_value(value)}" for name, value in values if value is not None]


def _toml_value(value: Any) -> str:
    if isinstance(value, str):
        return '"' + "".join(_escape(letter) for letter in value) + '"'
    if isinstance(value, tuple):
        return f"[{', '.join(_toml_value(item) for item in value)}]"
    return repr(value if isinstance(value, int) else float(value))


def _escape(letter: str) -> str:
    if letter in '"\\':
        return f"\\{letter}"
    return letter if letter.isprintable() else f"\\U{ord(letter):08x}"

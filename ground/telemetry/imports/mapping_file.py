"""Mappings from TOML, strictly: every problem at once, each with its line and with what would be right."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from ground.telemetry.imports.errors import BadImport
from ground.telemetry.imports.mapping import TICK, Channel, Csv, Mapping, Session, Time
from ground.telemetry.imports.start import start_of
from ground.telemetry.imports.targets import IMPORTED, Target, conversions, free_target, targets
from ground.telemetry.imports.units import Conversion, known_units
from ground.telemetry.imports.values import in_units
from sim.scenario.names import did_you_mean
from sim.scenario.toml_lines import NotToml, TomlPath, parse_toml
from sim.scenario.toml_record import Findings, read_record, require_table
from sim.scenario.toml_tables import list_tables

T = TypeVar("T")

KNOWN: Final = ("arm", "time", "csv", "channel", "start", "command", "session")
LISTED: Final = ("columns", "gain", "offset")
"""Keys of a channel that may be one value, too."""
MOST_MAPPING_BYTES: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class _Channel:
    """A table [[channel]] but for its constant value."""

    name: str
    columns: tuple[str, ...] | None = None
    unit: str | None = None
    gain: tuple[float, ...] = (1.0,)
    offset: tuple[float, ...] = (0.0,)


@dataclass(frozen=True, slots=True)
class _Head:
    """What a mapping says before its first table."""

    arm: str = "unknown"


def mapping_from(text: str, file: str, folder: Path) -> Mapping:
    """The mapping that a TOML text says; `file` is how messages call it, paths in it are from `folder`.

    Raises:
        BadImport: something in it is wrong; the message has every problem, by line.
    """
    if len(text) > MOST_MAPPING_BYTES:
        raise BadImport([f"{file}: has {len(text)} characters; a mapping has at most {MOST_MAPPING_BYTES}"])
    try:
        data, lines = parse_toml(text)
    except NotToml as error:
        raise BadImport([f"{file}:{error.line}: {error}"]) from error
    findings = Findings(lines)
    mapping = _mapping(data, file, folder, findings)
    if mapping is None or findings.problems:
        raise BadImport(f"{file}:{p.line}: {p.text}" for p in sorted(findings.problems))
    return mapping


def _mapping(data: dict[str, Any], file: str, folder: Path, findings: Findings) -> Mapping | None:
    for key in data:
        if key not in KNOWN:
            findings.report((key,), f"{key}: is not known here; {did_you_mean(key, KNOWN)}")
    head = read_record(_Head, {key: data[key] for key in ("arm",) if key in data}, (), findings)
    time = _record(Time, data, "time", findings)
    csv = _record(Csv, data, "csv", findings)
    channels = [_channel(table, place, findings) for place, table in list_tables(data, "channel", findings)]
    if not data.get("channel"):
        findings.report((), "channel: is missing; write [[channel]] and its keys below, once for each")
    _check_apart([channel for channel in channels if channel is not None], findings)
    start = start_of(data, folder, findings)
    session = _record(Session, data, "session", findings) if "session" in data else None
    if head is None or time is None or csv is None or None in channels:
        return None
    return Mapping(file, head.arm, time, csv, tuple(c for c in channels if c is not None), start, session)


def _record(kind: type[T], data: dict[str, Any], name: str, findings: Findings) -> T | None:
    table = require_table(data.get(name, {}), (name,), findings)
    return None if table is None else read_record(kind, table, (name,), findings)


def _channel(table: dict[str, Any], place: TomlPath, findings: Findings) -> Channel | None:
    before = len(findings.problems)
    listed = {k: [v] if k in LISTED and not isinstance(v, list) else v for k, v in table.items()}
    constant = listed.pop("value", None)
    said = read_record(_Channel, listed, place, findings)
    if said is None:
        return None
    if (said.columns is None) == (constant is None):
        findings.report(place, f"{said.name}: give columns, or value for what never changes; one of the two")
        return None
    target = _target(said, table, place, findings)
    if target is None:
        return None
    conversion = _conversion(said, target, place, findings)
    gain, offset = (
        _per_column(name, getattr(said, name), target, place, findings) for name in ("gain", "offset")
    )
    if said.columns is not None:
        _check_columns(said.columns, target, place, findings)
    if target.members is not None and (said.gain, said.offset) != ((1.0,), (0.0,)):
        findings.report(place, f"{target.name}: is a name; it has neither gain nor offset")
    kept = None if constant is None else _constant(constant, target, place, findings)
    if len(findings.problems) > before:
        return None
    line = findings.lines[place]
    channel = Channel(target, said.columns or (), kept, conversion, gain, offset, line)
    _check_finite(channel, (*place, "value"), findings)
    return channel


def _check_finite(channel: Channel, at: TomlPath, findings: Findings) -> None:
    """Refuse a constant that its gain, offset or unit makes infinite."""
    if not isinstance(channel.constant, np.ndarray) or channel.target.field.kind != "<f8":
        return
    with np.errstate(over="ignore", invalid="ignore"):
        is_finite = np.isfinite(in_units(channel, channel.constant, slice(None))).all()
    if not is_finite:
        findings.report(at, "value: is too large for its gain, offset and unit; are they right?")


def _target(said: _Channel, table: dict[str, Any], place: TomlPath, findings: Findings) -> Target | None:
    known = targets()
    if said.name in known:
        return known[said.name]
    at = (*place, "name")
    if not said.name.startswith(IMPORTED):
        findings.report(at, f"name: {said.name!r} is not known; {_near(said.name)}")
        return None
    if said.unit is None or said.unit not in known_units():
        findings.report((*place, "unit"), f"unit: {_unit_wanted(said.unit, known_units())}")
        return None
    columns = said.columns or ("value",)
    single = not isinstance(table.get("columns", table.get("value")), list)
    target = free_target(said.name, len(columns), said.unit, single)
    if isinstance(target, Target):
        return target
    findings.report(at, f"name: {said.name}: {target}")
    return None


def _near(name: str) -> str:
    meant, _, _ = did_you_mean(name, targets()).rpartition("there are ")
    return (
        f"{meant}`marsarm dictionary '/*'` lists our channels; write {IMPORTED}NAME.FIELD for one of your own"
    )


def _conversion(said: _Channel, target: Target, place: TomlPath, findings: Findings) -> Conversion:
    at = (*place, "unit")
    if target.members is not None:
        if said.unit is not None:
            findings.report(at, f"unit: {target.name} is a name or its number; leave it out")
        return Conversion()
    known = conversions(target.unit or "1")
    if said.unit is None and target.unit in ("bool", "cycle", "count", "1"):
        return Conversion()  # nothing else could be meant
    if said.unit not in known:
        findings.report(at, f"unit: {_unit_wanted(said.unit, known)}; {target.name} is kept in {target.unit}")
        return Conversion()
    return known[said.unit]


def _unit_wanted(unit: str | None, known: Any) -> str:
    if unit is None:
        return f"is missing; there are {', '.join(known)}"
    return f"{unit!r} does not fit; {did_you_mean(unit, known)}"


def _per_column(
    name: str, values: tuple[float, ...], target: Target, place: TomlPath, findings: Findings
) -> Any:
    if len(values) not in (1, target.size):
        findings.report(
            (*place, name), f"{name}: {len(values)} given; {target.name} takes one for all, or {target.each}"
        )
        return np.ones(target.size)
    return np.broadcast_to(np.array(values, np.float64), (target.size,))


def _check_columns(columns: tuple[str, ...], target: Target, place: TomlPath, findings: Findings) -> None:
    at = (*place, "columns")
    if len(columns) != target.size:
        findings.report(at, f"columns: {len(columns)} given; {target.name} takes {target.each}")
    for name in sorted({name for name in columns if columns.count(name) > 1}):
        findings.report(at, f"columns: {name!r} is there twice; each number has a column of its own")


def _constant(value: Any, target: Target, place: TomlPath, findings: Findings) -> Any:
    """The constant as it is given, one for each element; TICK where it is the number of the cycle."""
    at = (*place, "value")
    if value == TICK and target.unit == "cycle":
        return TICK
    items = value if isinstance(value, list) else [value] * target.size
    if len(items) != target.size:
        findings.report(at, f"value: {len(items)} given; {target.name} takes {target.each}")
        return None
    problem = next((p for p in (_not_a_value(item, target) for item in items) if p is not None), None)
    if problem is not None:
        findings.report(at, f"value: {problem}")
        return None
    if target.members is not None:
        items = [target.member(item) for item in items]
    return np.array(items, np.dtype(target.field.kind) if target.field.kind != "<f8" else np.float64)


def _not_a_value(item: Any, target: Target) -> str | None:
    match target.field.kind:
        case _ if target.members is not None:
            if isinstance(item, str) and target.member(item) is not None:
                return None
            hint = did_you_mean(str(item)[:60], list(target.members.__members__))
            return f"{item!r:.60} is not known; {hint}"
        case "|b1":
            return None if isinstance(item, bool) else f"{item!r:.60} is not true or false"
        case "<i8" if type(item) is int and abs(item) < 1 << 63:
            return None
        case "<i8":
            also = ', or "tick" for the number of the cycle' if target.unit == "cycle" else ""
            return f"{item!r:.60} is not a whole number of 64 bits{also}"
        case _:
            number = isinstance(item, int | float) and not isinstance(item, bool)
            if number and abs(item) < 1e300 and math.isfinite(item):
                return None
            return f"{item!r:.60} is not a finite number"


def _check_apart(channels: list[Channel], findings: Findings) -> None:
    """Refuse a channel that is mapped twice."""
    seen: dict[str, int] = {}
    for channel in channels:
        name = channel.target.name.lower()
        if name in seen:
            place = next(p for p, line in findings.lines.items() if line == channel.line and p)
            findings.report(
                place, f"{channel.target.name}: is mapped in line {seen[name]} already; map it once"
            )
        seen.setdefault(name, channel.line)

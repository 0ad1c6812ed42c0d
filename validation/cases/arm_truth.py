"""Truth of blind cases of this arm: records, plan from a seed, effects outside the catalogue, leakage.

The leakage check unpacks all bytes of a log. It searches them for names, numbers and seeds of the truth.
"""

import json
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, Literal

import numpy as np
from mcap.stream_reader import StreamReader

from marsarm.common.requests import NOMINAL_ARM
from marsarm.diagnosis.arm import demo
from marsarm.diagnosis.arm.arm_effects import locate, to_hypothesis
from marsarm.diagnosis.problem import Hypothesis
from marsarm.telemetry.events import record_to_json
from marsarm.telemetry.format import CHANNELS_KEY
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import SESSION
from sim.effects import catalogue
from sim.effects.effect import Effect
from sim.scenario.effects import BadEffect, effect_classes_in_file, parse_effect_text
from simgap import Family
from simgap.common.errors import BadRequest, UserError
from simgap.common.toml import read_toml

CaseKind = Literal["none", "single", "pair", "out-of-catalogue"]
KIND_SHARES: Final[dict[CaseKind, float]] = {"none": 12 / 44, "out-of-catalogue": 14 / 44, "pair": 6 / 44}
"""Shares of all cases; the others have one effect of the catalogue."""
ALLOWED_KEYS: Final = frozenset({
    *("marsarm", "mujoco", "numpy", "python", "cpu", "git"),
    *("params", "params_sha256", "boot", "commands", "commands_sha256", SESSION, CHANNELS_KEY),
})  # fmt: skip
"""Keys that the header of a blind log may have."""
FORBIDDEN_WORDS: Final = ("calibrated:", "as-built:", "mjcf_sha256", "scenario")
"""Words that a blind log must not contain."""
MIN_DIGITS: Final = 8
"""Number of digits from which on a number identifies the truth."""
NUMBER_PATTERN: Final = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?")
EFFECTS_FOLDER: Final = Path(__file__).parents[1] / "out_of_catalogue_effects"
LINK_FRAME: Final = {f"link{k}": f"arm{k + 1}" for k in range(1, 5)}
"""Frame of the spring of each link."""


@dataclass(frozen=True, slots=True)
class SealedEffect:
    """Effect that is switched on in a blind case."""

    name: str
    place: str
    values: dict[str, float]
    """Values of its parameters by name, in the units of the diagnosis."""
    times_limit: float
    """Amplitude as a multiple of the detection limit; of the typical size outside the catalogue."""
    spec: str
    """Text that switches the effect on in the plant."""


@dataclass(frozen=True, slots=True)
class TrueCase:
    """Blind case: its effects, the `background` of every arm, and the seed of the sensor noise."""

    name: str
    kind: CaseKind
    effects: tuple[SealedEffect, ...]
    background: tuple[str, ...]
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class PlannedCase:
    """Kind and sampled effects of a case."""

    kind: CaseKind
    effects: tuple[demo.SampledEffect, ...]


def plan_cases(
    cases: int,
    catalogue: Sequence[demo.DetectableEffect],
    outside: Sequence[demo.DetectableEffect],
    rng: np.random.Generator,
) -> tuple[PlannedCase, ...]:
    """Plan blind cases in random order.

    Effects are sampled first, then the place of each. The two effects of a pair have different classes.
    Effects outside the catalogue are dealt: none comes again before all have come. Where there are none of
    them, their cases have no effect.
    """
    known, unknown = ([one for one in some if one.can_sample()] for some in (catalogue, outside))
    counts = {kind: round(share * cases) for kind, share in KIND_SHARES.items()}
    if not unknown:
        counts["none"] += counts.pop("out-of-catalogue")
    kinds: list[CaseKind] = [kind for kind, count in counts.items() for _ in range(count)]
    kinds += ["single"] * (cases - len(kinds))
    deck = _deal_effects(unknown, kinds.count("out-of-catalogue"), rng)
    shuffled = [kinds[k] for k in rng.permutation(cases)]
    return tuple(PlannedCase(kind, _sample_effects(kind, known, deck, rng)) for kind in shuffled)


def _deal_effects(
    some: Sequence[demo.DetectableEffect], count: int, rng: np.random.Generator
) -> Iterator[demo.DetectableEffect]:
    """Yield so many effects, each at a random place; two effects differ by one case at most."""
    names = sorted({one.hypothesis.name for one in some})
    rounds = -(-count // max(len(names), 1))
    dealt = [names[k] for _ in range(rounds) for k in rng.permutation(len(names))]
    for name in dealt[:count]:
        yield demo.sample_effect([one for one in some if one.hypothesis.name == name], rng)


def _sample_effects(
    kind: CaseKind,
    known: Sequence[demo.DetectableEffect],
    unknown: Iterator[demo.DetectableEffect],
    rng: np.random.Generator,
) -> tuple[demo.SampledEffect, ...]:
    if kind == "none":
        return ()
    source = next(unknown) if kind == "out-of-catalogue" else demo.sample_effect(known, rng)
    first = source.sample(rng)
    if kind != "pair":
        return (first,)
    others = [one for one in known if one.label != first.source.label]
    return first, demo.sample_effect(others, rng).sample(rng)


@cache
def list_uncatalogued() -> Mapping[tuple[str, str], Hypothesis]:
    """List all out-of-catalogue effects by effect and place; BadRequest if there are no files."""
    files = sorted(EFFECTS_FOLDER.glob("*.py"))
    if not files:
        raise BadRequest(f"{EFFECTS_FOLDER}: holds no effects; cases are made in a clone of the repository")
    kinds = {kind.__name__: kind for file in files for kind in effect_classes_in_file(str(file))}
    found = [to_hypothesis(made, Family.EXTERNAL) for made in catalogue.hypotheses(kinds)]
    return {(one.name, one.place): one for one in found}


def resolve_effect(spec: str, tools: tuple[str, ...]) -> Effect:
    """Return the effect of a text, in the catalogue or in the folder, at an arm with these tools."""
    try:
        spec = re.sub(r"^(\w+)/\w+\.py:", r"\1.py:", spec)  # cases before 0.4: related/joints.py
        text = str(EFFECTS_FOLDER / spec) if ".py:" in spec else spec
        return parse_effect_text(text, tools)
    except BadEffect as error:
        raise BadRequest(str(error)) from error


@dataclass(frozen=True, slots=True)
class OutsideEffect:
    """Right answers for an effect that is in no catalogue."""

    families: frozenset[str]
    location: str
    """Its location where its place is none; else empty."""


@cache
def load_outside_effects() -> Mapping[str, OutsideEffect]:
    """Load the families and locations of the effects outside the catalogue, by name."""
    document = read_toml(EFFECTS_FOLDER / "families.toml")
    return {
        name: OutsideEffect(frozenset(one["families"]), one.get("location", ""))
        for effects in document.values()
        for name, one in effects.items()
    }


def locate_outside(effect: str, place: str) -> str:
    """Return the location of an effect outside the catalogue."""
    location = locate(effect, place)
    return load_outside_effects()[effect].location or LINK_FRAME.get(location, location)


class TruthLeaked(UserError):
    """Leak of the truth in a blind log, which is a bug; the message says what leaked."""

    exit_status = 1


def check_leakage(path: Path, case: TrueCase, arm: str = NOMINAL_ARM) -> None:
    """Raise TruthLeaked if a log has a header key, topic, name or number of the truth of its case."""
    log = read_log(path)
    extra_keys = sorted(set(log.header) - ALLOWED_KEYS)
    if extra_keys:
        raise TruthLeaked(f"{path}: its header says {', '.join(extra_keys)}")
    truth_topics = sorted(topic for topic in log.truth if topic in log.packets)
    if truth_topics:
        raise TruthLeaked(f"{path}: has the plant's own state in {', '.join(truth_topics)}")
    reference = json.loads(log.header["boot"])["reference"]
    nominal = record_to_json(demo.nominal_reference(arm))
    changed = sorted(name for name in nominal if name != "zero_rad" and reference[name] != nominal[name])
    if changed:
        raise TruthLeaked(f"{path}: flight software begins with {', '.join(changed)} that are not nominal")
    content = _log_bytes(path)
    for word in (*FORBIDDEN_WORDS, *sorted(_secret_words(case))):
        if word.encode() in content:
            raise TruthLeaked(f"{path}: holds {word!r}")
    for number in sorted(_secret_numbers(case)):
        if repr(number).encode() in content or struct.pack("<d", number) in content:
            raise TruthLeaked(f"{path}: holds {number!r}, a number of its truth")


def _secret_words(case: TrueCase) -> set[str]:
    """Return the hyphenated names of the effects, which no other text contains, and the seed."""
    names = {spec.split(":")[0] for spec in case.background} | {effect.name for effect in case.effects}
    seed = str(case.seed)
    return {name for name in names if "-" in name} | ({seed} if len(seed) >= MIN_DIGITS else set())


def _secret_numbers(case: TrueCase) -> set[float]:
    """Return the numbers with many digits in the effects."""
    specs = (*case.background, *(effect.spec for effect in case.effects))
    texts = {text for spec in specs for text in NUMBER_PATTERN.findall(spec)}
    return {float(text) for text in texts if sum(c.isdigit() for c in text) >= MIN_DIGITS}


def _log_bytes(path: Path) -> bytes:
    """Return the unpacked texts and bytes of all records."""
    with path.open("rb") as file:
        found = [value for record in StreamReader(file).records for value in vars(record).values()]
    texts = [str(value).encode() for value in found if isinstance(value, str | dict)]
    return b"\0".join([path.name.encode(), *texts, *(one for one in found if isinstance(one, bytes))])

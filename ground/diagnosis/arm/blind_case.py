"""Looks into a blind log, all of its bytes unpacked, for anything that would give its truth away."""

import json
import re
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from ground.diagnosis.blind_case import TrueCase
from ground.telemetry.format import CHANNELS_KEY
from ground.telemetry.header import SESSION
from ground.telemetry.json_codec import record_to_json
from ground.telemetry.read import read_log
from sim.arms import BuiltArm, arm_named, draw_calibration_errors
from sim.effects.effect import Effect
from sim.effects.joints import GearFriction
from sim.effects.numerics import Numerics
from sim.effects.sensors import CounterStart
from sim.initialisation import DAILY_FRICTION_SIGMA, true_reference

PLANT_NUMERICS: Final = Numerics("explicit", 7)
"""Finer and by another scheme than the solver's, and none that it knows; where steps are not much finer, that
scheme nearly diverges, and gears lie otherwise than finer computations have them."""


def sample_background(rng: np.random.Generator) -> tuple[Effect, ...]:
    """Errors that a calibration leaves, friction of the day, counters anywhere, and another computation."""
    errors = draw_calibration_errors(int(rng.integers(2**31)))
    friction = tuple(
        GearFriction(joint, float(np.exp(DAILY_FRICTION_SIGMA * rng.standard_normal()))) for joint in Joint
    )
    counters = tuple(CounterStart(joint, float(rng.uniform(-np.pi, np.pi))) for joint in Joint)
    return (PLANT_NUMERICS, *counters, *errors, *friction)


ALLOWED_KEYS: Final = frozenset({
    *("marsarm", "mujoco", "numpy", "python", "cpu", "git"),
    *("params", "params_sha256", "boot", "commands", "commands_sha256", SESSION, CHANNELS_KEY),
})  # fmt: skip
"""All that the header of a blind log may say."""
FORBIDDEN_WORDS: Final = ("calibrated:", "as-built:", "mjcf_sha256", "scenario")
MIN_DIGITS: Final = 8
"""Digits from which on a number is nobody else's."""
NUMBER_PATTERN: Final = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?")


class TruthLeaked(RuntimeError):
    """A blind log that gives something away; the message says what."""


def blind_reference(arm: BuiltArm) -> Reference:
    """The zeros that hardstops told of this arm; all else that they tell is as on the drawing."""
    return replace(_nominal_reference(), zero_rad=true_reference(arm).zero_rad)


@cache
def _nominal_reference() -> Reference:
    """What hardstops would tell of the drawing's arm; once in each process."""
    return true_reference(arm_named("nominal"))


def check_leakage(path: Path, case: TrueCase) -> None:
    """Raise TellsTruth if a log says something of its case's truth."""
    log = read_log(path)
    more = sorted(set(log.header) - ALLOWED_KEYS)
    if more:
        raise TruthLeaked(f"{path}: its header says {', '.join(more)}")
    told = sorted(topic for topic in log.truth if topic in log.packets)
    if told:
        raise TruthLeaked(f"{path}: has the plant's own state in {', '.join(told)}")
    believed = json.loads(log.header["boot"])["reference"]
    drawn = record_to_json(_nominal_reference())
    other = sorted(name for name in drawn if name != "zero_rad" and believed[name] != drawn[name])
    if other:
        raise TruthLeaked(
            f"{path}: flight software begins with {', '.join(other)} that are not the drawing's"
        )
    content = _log_bytes(path)
    for word in (*FORBIDDEN_WORDS, *sorted(_secret_words(case))):
        if word.encode() in content:
            raise TruthLeaked(f"{path}: holds {word!r}")
    for number in sorted(_secret_numbers(case)):
        if repr(number).encode() in content or struct.pack("<d", number) in content:
            raise TruthLeaked(f"{path}: holds {number!r}, a number of its truth")


def _secret_words(case: TrueCase) -> set[str]:
    """Names of its effects, as far as no other word is like them, and its seed."""
    names = {spec.split(":")[0] for spec in case.background} | {effect.name for effect in case.effects}
    seed = str(case.seed)
    return {name for name in names if "-" in name} | ({seed} if len(seed) >= MIN_DIGITS else set())


def _secret_numbers(case: TrueCase) -> set[float]:
    """Those that have many digits, as they are switched on."""
    specs = (*case.background, *(effect.spec for effect in case.effects))
    texts = {text for spec in specs for text in NUMBER_PATTERN.findall(spec)}
    return {float(text) for text in texts if sum(c.isdigit() for c in text) >= MIN_DIGITS}


def _log_bytes(path: Path) -> bytes:
    """What records hold, unpacked."""
    found: list[bytes] = [path.name.encode()]
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            found += _record_bytes(record)
    return b"\0".join(found)


def _record_bytes(record: Any) -> list[bytes]:
    if isinstance(record, Message | Schema | Attachment):
        return [record.data]
    if isinstance(record, Metadata):
        return [json.dumps(record.metadata, ensure_ascii=False).encode()]
    if isinstance(record, Channel):
        return [json.dumps([record.topic, record.metadata], ensure_ascii=False).encode()]
    return []

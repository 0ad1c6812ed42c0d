"""Blind cases of this arm: random background of every arm, and a leakage check of every log.

The leakage check unpacks all bytes of a log. It searches them for names, numbers and seeds of the truth.
"""

import json
import re
import struct
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from marsarm.diagnosis.arm.record import record_campaign
from marsarm.diagnosis.blind_case import TrueCase
from marsarm.telemetry.events import record_to_json
from marsarm.telemetry.format import CHANNELS_KEY
from marsarm.telemetry.header import SESSION
from marsarm.telemetry.read import read_log
from sim.arm_model.load import default_arm
from sim.arms import BuiltArm, arm_named, draw_calibration_errors, effects_of_run
from sim.diagnosis_campaign import DiagnosisSession, SessionFailed
from sim.effects.effect import Effect
from sim.effects.environment import Numerics
from sim.effects.joints import GearFriction
from sim.effects.sensors import CounterStart
from sim.initialisation import DAILY_FRICTION_SIGMA, true_reference
from sim.plant import PlantDiverged
from simgap.common.errors import UserError
from simgap.common.progress import Progress, no_progress

PLANT_NUMERICS: Final = Numerics("explicit", 7)
"""Numerics of the plant: finer than the solver's, and of a scheme that the solver does not know. With steps
that are not much finer, this scheme nearly diverges, and gears settle elsewhere than with finer steps."""
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


def sample_background(rng: np.random.Generator) -> tuple[Effect, ...]:
    """Sample the errors left by a calibration, friction of the day, counter offsets and other numerics."""
    errors = draw_calibration_errors(default_arm(), int(rng.integers(2**31)))
    friction = tuple(
        GearFriction(joint, float(np.exp(DAILY_FRICTION_SIGMA * rng.standard_normal()))) for joint in Joint
    )
    counters = tuple(CounterStart(joint, float(rng.uniform(-np.pi, np.pi))) for joint in Joint)
    return (PLANT_NUMERICS, *counters, *errors, *friction)


def record_blind(
    folder: Path,
    effects: tuple[Effect, ...],
    sessions: Sequence[DiagnosisSession],
    seed: int,
    progress: Progress,
) -> bool:
    """Record sessions of an arm with effects; one whose motion does not complete gets no log.

    Args:
        folder: Folder of the logs.
        effects: Effects that are switched on, and numerics.
        sessions: Sessions of the campaign.
        seed: Seed of the sensor noise.
        progress: Called with done, total and step.

    Returns:
        True if all sessions have a log.
    """
    arm = arm_named("nominal").with_effects(effects)
    reference, begun = blind_reference(arm), effects_of_run(effects)
    is_complete = True
    numbers = np.random.default_rng(seed).integers(2**31, size=len(sessions))
    for done, (session, number) in enumerate(zip(sessions, numbers, strict=True)):
        progress(done, len(sessions), "recording")
        try:
            record_campaign(folder, [session], arm, reference, int(number), no_progress, begun)
        except (SessionFailed, PlantDiverged):
            (folder / f"{session.name}.mcap").unlink(missing_ok=True)
            is_complete = False
    return is_complete


class TruthLeaked(UserError):
    """Leak of the truth in a blind log, which is a bug; the message says what leaked."""

    exit_status = 1


def blind_reference(arm: BuiltArm) -> Reference:
    """Return the joint zeros that homing of this arm finds; all else is nominal."""
    return replace(_nominal_reference(), zero_rad=true_reference(arm).zero_rad)


@cache
def _nominal_reference() -> Reference:
    """Return the homing result of the nominal arm; computed once in each process."""
    return true_reference(arm_named("nominal"))


def check_leakage(path: Path, case: TrueCase) -> None:
    """Check that a log does not reveal the truth of its case.

    Raises:
        TruthLeaked: The log contains a header key, topic, name or number of the truth.
    """
    log = read_log(path)
    extra_keys = sorted(set(log.header) - ALLOWED_KEYS)
    if extra_keys:
        raise TruthLeaked(f"{path}: its header says {', '.join(extra_keys)}")
    truth_topics = sorted(topic for topic in log.truth if topic in log.packets)
    if truth_topics:
        raise TruthLeaked(f"{path}: has the plant's own state in {', '.join(truth_topics)}")
    reference = json.loads(log.header["boot"])["reference"]
    nominal = record_to_json(_nominal_reference())
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
    """Return the unpacked contents of all records."""
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

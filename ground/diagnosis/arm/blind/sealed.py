"""Looks into a blind log, all of its bytes unpacked, for anything that would give its truth away."""

import json
import re
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from fsw.estimate.reference import Reference
from ground.diagnosis.blind.truth import TrueCase
from ground.telemetry.format import CHANNELS_KEY
from ground.telemetry.header import SESSION
from ground.telemetry.json_codec import record_to_json
from ground.telemetry.read import read_log
from sim.arms import BuiltArm, arm_named
from sim.initialisation import true_reference

KEYS: Final = frozenset({
    *("marsarm", "mujoco", "numpy", "python", "cpu", "git"),
    *("params", "params_sha256", "boot", "commands", "commands_sha256", SESSION, CHANNELS_KEY),
})  # fmt: skip
"""All that the header of a blind log may say."""
WORDS: Final = ("calibrated:", "as-built:", "mjcf_sha256", "scenario")
TELLING: Final = 8
"""Digits from which on a number is nobody else's."""
NUMBER: Final = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?")


class TellsTruth(RuntimeError):
    """A blind log that gives something away; the message says what."""


def blind_reference(arm: BuiltArm) -> Reference:
    """The zeros that hardstops told of this arm; all else that they tell is as on the drawing."""
    return replace(_drawn(), zero_rad=true_reference(arm).zero_rad)


@cache
def _drawn() -> Reference:
    """What hardstops would tell of the drawing's arm; once in each process."""
    return true_reference(arm_named("nominal"))


def check_sealed(path: Path, case: TrueCase) -> None:
    """Raise TellsTruth if a log says something of its case's truth."""
    log = read_log(path)
    more = sorted(set(log.header) - KEYS)
    if more:
        raise TellsTruth(f"{path}: its header says {', '.join(more)}")
    told = sorted(topic for topic in log.truth if topic in log.packets)
    if told:
        raise TellsTruth(f"{path}: has the plant's own state in {', '.join(told)}")
    believed = json.loads(log.header["boot"])["reference"]
    drawn = record_to_json(_drawn())
    other = sorted(name for name in drawn if name != "zero_rad" and believed[name] != drawn[name])
    if other:
        raise TellsTruth(f"{path}: flight software begins with {', '.join(other)} that are not the drawing's")
    content = _content(path)
    for word in (*WORDS, *sorted(_words(case))):
        if word.encode() in content:
            raise TellsTruth(f"{path}: holds {word!r}")
    for number in sorted(_numbers(case)):
        if repr(number).encode() in content or struct.pack("<d", number) in content:
            raise TellsTruth(f"{path}: holds {number!r}, a number of its truth")


def _words(case: TrueCase) -> set[str]:
    """Names of its effects, as far as no other word is like them, and its seed."""
    names = {spec.split(":")[0] for spec in case.background} | {effect.name for effect in case.effects}
    seed = str(case.seed)
    return {name for name in names if "-" in name} | ({seed} if len(seed) >= TELLING else set())


def _numbers(case: TrueCase) -> set[float]:
    """Those that have many digits, as they are switched on."""
    specs = (*case.background, *(effect.spec for effect in case.effects))
    texts = {text for spec in specs for text in NUMBER.findall(spec)}
    return {float(text) for text in texts if sum(c.isdigit() for c in text) >= TELLING}


def _content(path: Path) -> bytes:
    """What records hold, unpacked."""
    found: list[bytes] = [path.name.encode()]
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            found += _of(record)
    return b"\0".join(found)


def _of(record: Any) -> list[bytes]:
    if isinstance(record, Message | Schema | Attachment):
        return [record.data]
    if isinstance(record, Metadata):
        return [json.dumps(record.metadata, ensure_ascii=False).encode()]
    if isinstance(record, Channel):
        return [json.dumps([record.topic, record.metadata], ensure_ascii=False).encode()]
    return []

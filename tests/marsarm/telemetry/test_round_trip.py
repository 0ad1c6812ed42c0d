"""What goes into a log comes back: packets, times, topics and the header."""

import hashlib
import json
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from fsw.dictionary.commands import MoveJoint, Stop
from fsw.dictionary.enums import Joint
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recorder import commands_header, flight_header, model_digest, run_header
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.setting import World
from tests.marsarm.telemetry.lab import cycle_at, packet_of, record

HOSTILE_BYTES = [b"\x00", b"\xff", b"\x00\x00\x00\x00\x00\x00\x00\x80", b"\x01\x00\x00\x00\x00\x00\xf0\x7f"]
"""Bits of zero; of NaN and -1; of the least integer and -0.0; of a signalling NaN."""


def leaves(part: Any, name: str = "") -> list[tuple[str, str, Any]]:
    """Return topic, field and value of everything in a cycle except tick, commands and EVRs."""
    if not is_dataclass(part):
        return []
    found = []
    for one in fields(part):
        value = getattr(part, one.name)
        if is_dataclass(value):
            found += leaves(value, f"/{one.name}")
        elif name and not isinstance(value, tuple) and value is not None:
            found.append((name, one.name, value))
    return found


def assert_holds(log: Log, cycles: list[CycleRecord]) -> None:
    for row, cycle in enumerate(cycles):
        for topic, name, value in leaves(cycle):
            logged = log[topic][name][row]
            assert logged.shape == np.shape(value)
            assert logged.tobytes() == np.asarray(value).tobytes(), f"{topic} {name} in cycle {row}"


@pytest.mark.parametrize("bits", HOSTILE_BYTES, ids=bytes.hex)
def test_extreme_numbers_come_back(tmp_path: Path, bits: bytes) -> None:
    cycles = [packet_of(CycleRecord, lambda size: (bits * size)[:size], tick=0)]
    assert_holds(read_log(record(tmp_path / "run.mcap", cycles)), cycles)


def test_times_are_the_ticks_exactly(tmp_path: Path) -> None:
    ticks = [0, 1, 64 * 3600 * 24 * 669]
    log = read_log(record(tmp_path / "run.mcap", [replace(cycle_at(0), tick=tick) for tick in ticks]))
    assert log.ticks("/sensors").tolist() == ticks
    assert log.time_ns["/drive"].tolist() == [tick * 10**9 // 64 for tick in ticks]


def test_a_packet_that_is_not_there_every_cycle_keeps_its_times(tmp_path: Path) -> None:
    cycles = [cycle_at(tick) for tick in range(6)]
    cycles[1:3] = [replace(c, truth=None, outputs=replace(c.outputs, tool=None)) for c in cycles[1:3]]
    log = read_log(record(tmp_path / "run.mcap", cycles))
    assert log.ticks("/tool").tolist() == log.ticks("/truth").tolist() == [0, 3, 4, 5]
    assert len(log["/joint"]) == 6


def test_a_topic_that_got_nothing_is_missing_by_name(tmp_path: Path) -> None:
    log = read_log(record(tmp_path / "run.mcap", [replace(cycle_at(0), truth=None)]))
    with pytest.raises(KeyError, match="no topic /truth; it has /drive, /joint, /sensors, /tool"):
        log["/truth"]


def test_the_header_comes_back_and_an_empty_run_is_a_log(tmp_path: Path) -> None:
    log = read_log(record(tmp_path / "run.mcap", []))
    assert {name: text for name, text in log.header.items() if name != "channels"} == {
        "seed": "1",
        "arm": "nominal",
    }
    assert not log.truncated
    assert (dict(log.packets), log.evrs, log.commands) == ({}, (), ())


def test_the_same_records_give_the_same_messages(tmp_path: Path) -> None:
    def messages(name: str, chunk_cycles: int) -> list[tuple[str, int, int, bytes]]:
        path = record(tmp_path / name, map(cycle_at, range(20)), chunk_cycles=chunk_cycles)
        with path.open("rb") as file:
            found = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
            return [(c.topic, m.log_time, m.sequence, m.data) for _, c, m in found]

    assert messages("long.mcap", 64) == messages("short.mcap", 1)


KEYS = {
    *("marsarm", "mujoco", "numpy", "python", "cpu", "git", "arm", "seed", "request", "effects"),
    *("params", "params_sha256", "mjcf_sha256", "commands", "commands_sha256", "boot"),
}


def loop_of(name: str = "nominal", world: World | None = None) -> ClosedLoop:
    arm = arm_named(name)
    return ClosedLoop(Setup(arm, world or World(), arm.params.poses.stowed_rad, 3))


@cache
def nominal() -> ClosedLoop:
    """Return a loop that no test may advance."""
    return loop_of()


def test_a_header_holds_everything_as_text():
    header = run_header(nominal(), "nominal", 3, {"tool": "apxs"}, (Stop(),))
    assert header.keys() == KEYS
    assert all(isinstance(value, str) for value in header.values())
    assert json.loads(header["boot"])["mode"] == "STOWED"
    assert header["params_sha256"] == nominal().config.params_sha256
    assert json.loads(header["cpu"])[-1].startswith("OpenBLAS ")
    assert (header["seed"], json.loads(header["request"])) == ("3", {"tool": "apxs"})


def test_the_flight_header_has_nothing_of_the_plant():
    """The flight header has no arm, seed, request, effects or digest of the model."""
    flown = flight_header(nominal(), (Stop(),))
    assert KEYS - flown.keys() == {"arm", "seed", "request", "effects", "mjcf_sha256"}


def test_the_plants_digest_knows_the_world_and_the_arm():
    loops = (nominal(), loop_of(world=World(tilt_roll_rad=1e-9)), loop_of("as-built:1"))
    assert len({model_digest(loop.plant.model) for loop in loops}) == 3


def test_a_digest_is_that_of_the_commands_as_written():
    header = commands_header((MoveJoint(Joint.WRIST, 0.1),))
    written = [{"type": "MoveJoint", "fields": {"joint": "WRIST", "angle_rad": 0.1, "backlash": "on"}}]
    assert json.loads(header["commands"]) == written
    assert header["commands_sha256"] == hashlib.sha256(header["commands"].encode()).hexdigest()

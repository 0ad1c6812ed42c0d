"""Reading of logs: what goes in comes back; parts by topic and time; truncated, damaged and foreign files."""

import hashlib
import json
import os
import struct
from collections.abc import Iterable
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from fsw.dictionary.commands import MoveJoint, Stop
from fsw.dictionary.enums import Joint
from marsarm.telemetry.format import (
    FORMAT,
    FORMAT_RECORD,
    HEADER_RECORD,
    TICK_NS,
    LogDamaged,
    LogNotReadable,
    header_crc32,
)
from marsarm.telemetry.mcap_columns import read_records
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import commands_header, flight_header, model_digest, run_header
from marsarm.telemetry.recover import recover
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.setting import World
from simgap.common.progress import no_progress
from tests.marsarm.telemetry.lab import cycle_at, packet_of, record

N_CYCLES = 30
LAYOUT = [["angle_rad", "<f8", None]]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("part")
    return record(folder / "run.mcap", map(cycle_at, range(N_CYCLES)), chunk_cycles=1)


def test_only_the_topics_asked_for_are_there(path):
    log = read_log(path, topics=["/joint", "/evr"])
    assert (set(log.packets), set(log.time_ns)) == ({"/joint"}, {"/joint", "/evr"})
    assert (len(log.evrs), len(log.commands)) == (2 * N_CYCLES, 0)


@pytest.mark.parametrize(
    ("start", "end"), [(0, N_CYCLES), (7, 19), (7, None), (None, 19), (12, 13), (N_CYCLES, None), (5, 5)]
)
@pytest.mark.parametrize("kept", [1.0, 0.99], ids=["closed", "cut short"])
def test_only_the_time_asked_for_is_there(path, tmp_path, start, end, kept):
    data = path.read_bytes()
    part = tmp_path / "part.mcap"
    part.write_bytes(data[: int(kept * len(data))])
    whole = read_log(part)
    log = read_log(
        part,
        start_ns=None if start is None else start * TICK_NS,
        end_ns=None if end is None else end * TICK_NS,
    )
    for topic, packets in whole.packets.items():
        due = packets[start or 0 : end]
        assert log.packets.get(topic, packets[:0]).tobytes() == due.tobytes()
    assert [evr.tick for evr in log.evrs] == [
        e.tick for e in whole.evrs if (start or 0) <= e.tick < (end or 99)
    ]


def test_what_unpacks_to_more_than_is_read_at_once_is_read_in_parts(path, monkeypatch):
    monkeypatch.setattr("marsarm.telemetry.read.MAX_UNPACKED_BYTES", 50_000)
    with pytest.raises(LogNotReadable, match="ask for a part, from one time to another"):
        read_log(path)
    assert len(read_log(path, start_ns=2 * TICK_NS, end_ns=5 * TICK_NS)["/joint"]) == 3


def written(path: Path, messages: Iterable[tuple[str, int, int, float]], header: dict[str, str]) -> Path:
    """Write a log with the stock writer from topic, sequence, log time and value of each message."""
    with path.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start()
        writer.add_metadata(FORMAT_RECORD, {"version": FORMAT, "header_crc32": header_crc32(header)})
        writer.add_metadata(HEADER_RECORD, header)
        ids: dict[str, int] = {}
        for topic, sequence, time_ns, value in messages:
            if topic not in ids:
                ids[topic] = writer.register_channel(topic, "cdr", 0)
            body = b"\x00\x01\x00\x00" + struct.pack("<d", value)
            writer.add_message(ids[topic], time_ns, body, time_ns, sequence)
        writer.finish()
    return path


def test_the_header_says_what_the_messages_are_and_others_are_passed_over(tmp_path):
    about = {"id": 1, "schema": "s", "layout": LAYOUT, "truth": True, "derived": False}
    topics = {"/a": about, "/tf": about | {"id": 2, "layout": None, "derived": True}}
    messages = [("/a", 0, 5, 0.5), ("/tf", 0, 5, 0.0), ("/others", 9, 3, 0.0)]
    path = written(tmp_path / "old.mcap", messages, {"channels": json.dumps(topics)})
    log = read_log(path)
    assert (set(log.time_ns), log["/a"]["angle_rad"].tolist(), log.truth) == ({"/a"}, [0.5], {"/a"})
    report = recover(path, tmp_path / "new.mcap", no_progress)
    assert set(report.saved) == {"/a"}
    assert set(read_log(tmp_path / "new.mcap").time_ns) == {"/a"}


@pytest.mark.parametrize(
    ("times_ns", "why"),
    [
        ((0, 2 * 10**9, 10**9), r"message 2 of /a, at 1.000000 s, comes after one of 2.000000 s"),
        ((0, 10**9, 10**9), r"messages 1 and 2 of /a are both of 1.000000 s"),
    ],
    ids=["shuffled", "duplicate"],
)
def test_times_that_do_not_go_forward_are_refused(tmp_path, times_ns, why):
    messages = [("/a", k, time_ns, 0.5) for k, time_ns in enumerate(times_ns)]
    topics = {"/a": {"id": 1, "schema": "s", "layout": LAYOUT, "truth": False, "derived": False}}
    with pytest.raises(LogDamaged, match=why):
        read_log(written(tmp_path / "times.mcap", messages, {"channels": json.dumps(topics)}))


def test_a_header_that_announces_nonsense_is_refused(tmp_path):
    for nonsense in ("[1]", "{", '{"/a": 1}', '{"/a": {"id": 1, "layout": [["x", "O", null]]}}'):
        with pytest.raises(LogDamaged):
            read_log(written(tmp_path / "n.mcap", [("/a", 0, 5, 0.5)], {"channels": nonsense}))


def test_a_log_whose_last_chunk_is_whole_but_whose_length_is_not_is_not_taken_for_cut(path, tmp_path):
    data = path.read_bytes()
    begins = [at for at, _ in read_records(data).chunks]
    cut = bytearray(data[: begins[-1] - 1])
    cut[begins[-2] + 6] ^= 0x10  # of the length of the last chunk
    (tmp_path / "cut.mcap").write_bytes(cut)
    with pytest.raises(LogDamaged, match="a record is broken"):
        read_log(tmp_path / "cut.mcap")


def test_a_chunk_taken_out_is_missed(tmp_path, path):
    log_bytes = path.read_bytes()
    chunks = [at for at, _ in read_records(log_bytes).chunks]
    without_second = log_bytes[: chunks[1]] + log_bytes[chunks[2] : chunks[4]]
    (tmp_path / "short.mcap").write_bytes(without_second)
    with pytest.raises(LogDamaged, match="missing or out of order"):
        read_log(tmp_path / "short.mcap")


def test_a_foreign_mcap_is_not_our_log(tmp_path):
    path = tmp_path / "foreign.mcap"
    writer = Writer(str(path))
    writer.start()
    writer.add_message(writer.register_channel("/a", "json", 0), 0, b"{}", 0)
    writer.finish()
    with pytest.raises(LogNotReadable, match="not a marsarm log"):
        read_log(path)


def test_a_file_larger_than_any_log_is_not_read(tmp_path):
    path = tmp_path / "sparse.mcap"
    path.touch()
    os.truncate(path, 30 << 30)
    with pytest.raises(LogNotReadable, match="has 32212254720 bytes, more than 4294967296"):
        read_log(path)


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


@pytest.mark.parametrize("bits", HOSTILE_BYTES, ids=bytes.hex)
def test_extreme_numbers_come_back(tmp_path, bits):
    cycle = packet_of(CycleRecord, lambda size: (bits * size)[:size], tick=0)
    log = read_log(record(tmp_path / "run.mcap", [cycle]))
    for topic, name, value in leaves(cycle):
        (logged,) = log[topic][name]
        assert logged.shape == np.shape(value)
        assert logged.tobytes() == np.asarray(value).tobytes(), f"{topic} {name}"


def test_times_are_the_ticks_exactly(tmp_path):
    ticks = [0, 1, 64 * 3600 * 24 * 669]
    log = read_log(record(tmp_path / "run.mcap", [replace(cycle_at(0), tick=tick) for tick in ticks]))
    assert log.ticks("/sensors").tolist() == ticks
    assert log.time_ns["/drive"].tolist() == [tick * 10**9 // 64 for tick in ticks]


def test_a_packet_that_is_not_there_every_cycle_keeps_its_times(tmp_path):
    cycles = [cycle_at(tick) for tick in range(6)]
    cycles[1:3] = [replace(c, truth=None, outputs=replace(c.outputs, tool=None)) for c in cycles[1:3]]
    log = read_log(record(tmp_path / "run.mcap", cycles))
    assert log.ticks("/tool").tolist() == log.ticks("/truth").tolist() == [0, 3, 4, 5]
    assert len(log["/joint"]) == 6


def test_a_topic_that_got_nothing_is_missing_by_name(tmp_path):
    log = read_log(record(tmp_path / "run.mcap", [replace(cycle_at(0), truth=None)]))
    with pytest.raises(KeyError, match="no topic /truth; it has /drive, /joint, /readings, /sensors, /tool"):
        log["/truth"]


def test_the_header_comes_back_and_an_empty_run_is_a_log(tmp_path):
    log = read_log(record(tmp_path / "run.mcap", []))
    header = {name: text for name, text in log.header.items() if name != "channels"}
    assert header == {"seed": "1", "arm": "nominal"}
    assert not log.truncated
    assert (dict(log.packets), log.evrs, log.commands) == ({}, (), ())


def test_the_same_records_give_the_same_messages(tmp_path):
    def messages(name: str, chunk_cycles: int) -> list[tuple[str, int, int, bytes]]:
        path = record(tmp_path / name, map(cycle_at, range(20)), chunk_cycles=chunk_cycles)
        with path.open("rb") as file:
            found = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
            return [(c.topic, m.log_time, m.sequence, m.data) for _, c, m in found]

    assert messages("long.mcap", 64) == messages("short.mcap", 1)


def test_a_cycle_that_cannot_be_written_leaves_a_whole_log_of_the_earlier_ones(tmp_path):
    with pytest.raises(TypeError):
        record(tmp_path / "run.mcap", [cycle_at(0), replace(cycle_at(1), commands=(object(),))])
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/sensors"]), log.truncated) == (1, False)


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

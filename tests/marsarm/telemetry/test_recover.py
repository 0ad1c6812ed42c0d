"""Recovery saves undamaged messages bit for bit, and reports the others."""

from dataclasses import replace
from pathlib import Path

import pytest

from marsarm.telemetry.format import TICK_NS, LogDamaged, LostMessages
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recover import RecoveryReport, recover
from tests.marsarm.telemetry.lab import cycle_at, record
from validation.broken_logs import CUT_EVERY, change_records, flip_bits, is_part, original, truncate_file

N_CYCLES = 12
PACKETS = ["/sensors", "/drive", "/joint", "/tool", "/truth"]


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the log of another run, longer than the first."""
    folder = tmp_path_factory.mktemp("other")
    cycles = map(cycle_at, range(2 * N_CYCLES))
    return bytes(record(folder / "run.mcap", cycles, chunk_cycles=1).read_bytes())


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("log")
    path = record(folder / "run.mcap", map(cycle_at, range(N_CYCLES)), chunk_cycles=1)
    return path.read_bytes()


def chunk_of(data: bytes, tick: int) -> int:
    """Return the byte where the chunk with the messages of a tick begins."""
    found = original(data).chunks
    return next(one.at for one in found if one.first_ns <= tick * TICK_NS <= one.last_ns)


def saved(folder: Path, data: bytes) -> RecoveryReport:
    (folder / "bad.mcap").write_bytes(data)
    return recover(folder / "bad.mcap", folder / "good.mcap", lambda *_: None)


def broken(data: bytes, *places: int) -> bytes:
    changed = bytearray(data)
    for at in places:
        changed[at] ^= 1
    return bytes(changed)


def test_the_losses_of_a_broken_chunk_are_reported_by_topic_and_time(tmp_path: Path, data: bytes) -> None:
    recovered = saved(tmp_path, broken(data, chunk_of(data, 5) + 200))
    due = {topic: LostMessages(topic, 1, 4 * TICK_NS, 6 * TICK_NS) for topic in PACKETS}
    lost = {one.topic: one for one in recovered.lost}
    assert {topic: lost[topic] for topic in PACKETS} == due
    assert (lost["/evr"].count, lost["/command"].count) == (2, 2)
    with pytest.raises(LogDamaged):
        read_log(tmp_path / "bad.mcap")
    log = read_log(tmp_path / "good.mcap")
    assert log.lost == recovered.lost
    assert log.ticks("/joint").tolist() == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert not log.truncated


def test_losses_at_the_end_are_of_an_unknown_number(tmp_path: Path, data: bytes) -> None:
    recovered = saved(tmp_path, broken(data, chunk_of(data, N_CYCLES - 1) + 200))
    assert recovered.lost == (LostMessages(None, None, (N_CYCLES - 2) * TICK_NS, None),)
    assert recovered.lost[0].sentence == "an unknown number of messages of all topics lost, after 0.156250 s"


def test_a_rare_topic_may_have_lost_any_number_of_messages_at_a_break(tmp_path: Path) -> None:
    cycles = [cycle_at(tick) if tick < 3 else replace(cycle_at(tick), commands=()) for tick in range(8)]
    data = record(tmp_path / "run.mcap", cycles, chunk_cycles=1).read_bytes()
    recovered = saved(tmp_path, broken(data, chunk_of(data, 5) + 200))
    assert LostMessages("/command", None, 4 * TICK_NS, 6 * TICK_NS) in recovered.lost


def test_losses_at_the_beginning_are_reported(tmp_path: Path, data: bytes) -> None:
    recovered = saved(tmp_path, broken(data, chunk_of(data, 0) + 200))
    assert LostMessages("/joint", 1, None, TICK_NS) in recovered.lost


def test_an_undamaged_log_loses_nothing(tmp_path: Path, data: bytes) -> None:
    assert saved(tmp_path, data).lost == ()
    assert is_part(read_log(tmp_path / "good.mcap"), read_log(tmp_path / "bad.mcap"))


@pytest.mark.parametrize("end", ["closed", "killed"])
def test_two_runs_in_one_file_do_not_become_one_log(
    tmp_path: Path, data: bytes, other: bytes, end: str
) -> None:
    first = data if end == "closed" else data[: chunk_of(data, 8)]
    recovered = saved(tmp_path, first + other)
    (tmp_path / "first.mcap").write_bytes(first)
    assert is_part(read_log(tmp_path / "good.mcap"), read_log(tmp_path / "first.mcap"))
    assert recovered.saved["/joint"] == (N_CYCLES if end == "closed" else 8)
    assert "after the end of the log are left out" in recovered.notes[0]


@pytest.mark.parametrize("behind", [b"garbage", b"\0" * 4096])
def test_bytes_after_a_log_are_reported_and_cost_no_message(
    tmp_path: Path, data: bytes, other: bytes, behind: bytes
) -> None:
    for rest in (behind, other):
        (tmp_path / "run.mcap").write_bytes(data + rest)
        log = read_log(tmp_path / "run.mcap")
        assert (log.truncated, log.trailing_bytes, len(log["/joint"])) == (False, len(rest), N_CYCLES)


def test_a_chunk_that_is_there_twice_is_saved_once(tmp_path: Path, data: bytes) -> None:
    a, b = (chunk_of(data, tick) for tick in (4, 5))
    recovered = saved(tmp_path, data[:b] + data[a:b] + data[b:])
    assert "duplicate messages left out" in recovered.notes[0]
    assert read_log(tmp_path / "good.mcap").ticks("/joint").tolist() == list(range(N_CYCLES))


def test_a_lost_header_is_reported_and_the_values_are_saved(tmp_path: Path, data: bytes) -> None:
    at = data.index(b"nominal")
    recovered = saved(tmp_path, broken(data, at))
    assert recovered.header_lost
    log = read_log(tmp_path / "good.mcap")
    assert (len(log["/joint"]), list(log.header)) == (N_CYCLES, ["channels"])


@pytest.mark.parametrize("kept", [1.0, 0.6], ids=["closed", "cut short"])
def test_bits_flipped_anywhere(tmp_path: Path, data: bytes, kept: float) -> None:
    found = flip_bits(original(data[: int(kept * len(data))]), 30, 6, tmp_path)
    assert found.wrong == []
    assert found.read["detected"] > 10


def test_files_cut_anywhere(tmp_path: Path, data: bytes) -> None:
    found = truncate_file(original(data), CUT_EVERY // 4, tmp_path)
    assert found.wrong == []
    assert found.read["cut"] > 5


def test_records_that_do_not_fit_are_read_or_refused(tmp_path: Path, data: bytes) -> None:
    found = change_records(original(data[: int(0.6 * len(data))]), 60, 6, tmp_path)
    assert (found.wrong, found.read.keys()) == ([], {"read", "refused"})

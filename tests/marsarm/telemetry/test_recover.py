"""Recovery saves undamaged messages bit for bit, and reports the others."""

from pathlib import Path
from typing import Any

import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Metadata

from marsarm.telemetry.errors import LogNotReadable
from marsarm.telemetry.format import FORMAT, FORMAT_RECORD, HEADER_RECORD, TICK_NS, header_crc32
from marsarm.telemetry.lost_messages import LogDamaged, LostMessages
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recover import RecoveryReport, recover
from simgap.common.errors import BadRequest
from validation.damage import CUT_EVERY, flip_bits, is_part, original, truncate_file
from validation.fuzz_inputs import parts

N_CYCLES = 12
PACKETS = ["/sensors", "/drive", "/joint", "/tool", "/truth"]


@pytest.fixture(scope="module")
def other(make: Any, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the log of another run, longer than the first."""
    folder = tmp_path_factory.mktemp("other")
    cycles = map(make.cycle_at, range(2 * N_CYCLES))
    return bytes(make.record(folder / "run.mcap", cycles, chunk_s=0.0).read_bytes())


@pytest.fixture(scope="module")
def data(make: Any, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("log")
    path = make.record(folder / "run.mcap", map(make.cycle_at, range(N_CYCLES)), chunk_s=0.0)
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
    log = read_log(tmp_path / "good.mcap")
    assert log.lost == recovered.lost
    assert log.ticks("/joint").tolist() == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert not log.truncated


def test_the_strict_reader_reports_the_same_span(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "bad.mcap").write_bytes(broken(data, chunk_of(data, 5) + 200))
    with pytest.raises(LogDamaged, match=r"lost, between 0\.062500 s and 0\.093750 s \(byte"):
        read_log(tmp_path / "bad.mcap")


def test_the_counts_of_a_closed_log_show_losses_at_its_end(tmp_path: Path, data: bytes) -> None:
    recovered = saved(tmp_path, broken(data, chunk_of(data, N_CYCLES - 1) + 200))
    assert LostMessages("/joint", 1, (N_CYCLES - 2) * TICK_NS, None) in recovered.lost
    assert all(one.count is not None for one in recovered.lost)


def test_losses_at_the_beginning_are_reported(tmp_path: Path, data: bytes) -> None:
    recovered = saved(tmp_path, broken(data, chunk_of(data, 0) + 200))
    assert LostMessages("/joint", 1, None, TICK_NS) in recovered.lost


def test_the_losses_at_the_end_of_a_truncated_log_are_unknown(tmp_path: Path, data: bytes) -> None:
    recovered = saved(tmp_path, data[: chunk_of(data, 8) + 100])
    assert recovered.lost == (LostMessages(None, None, 7 * TICK_NS, None),)
    assert recovered.lost[0].sentence == "an unknown number of messages of all topics lost, after 0.109375 s"


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


def test_chunks_out_of_order_are_put_in_order(tmp_path: Path, data: bytes) -> None:
    a, b, c = (chunk_of(data, tick) for tick in (4, 5, 6))
    shuffled = data[:a] + data[b:c] + data[a:b] + data[c:]
    recovered = saved(tmp_path, shuffled)
    assert (recovered.lost, recovered.notes) == ((), ("its chunks are out of order",))
    assert read_log(tmp_path / "good.mcap").ticks("/joint").tolist() == list(range(N_CYCLES))
    with pytest.raises(LogDamaged, match="its chunks are out of order, no message was lost"):
        read_log(tmp_path / "bad.mcap")


def test_a_chunk_that_is_there_twice_is_saved_once(tmp_path: Path, data: bytes) -> None:
    a, b = (chunk_of(data, tick) for tick in (4, 5))
    recovered = saved(tmp_path, data[:b] + data[a:b] + data[b:])
    assert recovered.notes == ("1 chunk is in it twice",)
    assert read_log(tmp_path / "good.mcap").ticks("/joint").tolist() == list(range(N_CYCLES))


def test_a_lost_header_is_reported_and_the_values_are_saved(tmp_path: Path, data: bytes) -> None:
    at = data.index(b"nominal")
    recovered = saved(tmp_path, broken(data, at))
    assert recovered.header_lost
    log = read_log(tmp_path / "good.mcap")
    assert (len(log["/joint"]), dict(log.header)) == (N_CYCLES, {})


@pytest.mark.parametrize(("old", "new"), [("schema", "scheme"), ("layout", "layer_"), ("truth", "trust")])
def test_a_header_that_does_not_describe_its_topics_is_left_out(
    tmp_path: Path, data: bytes, old: str, new: str
) -> None:
    intact = original(data).log.header
    header = {name: value.replace(f'"{old}"', f'"{new}"') for name, value in intact.items()}
    records = RecordBuilder()
    about = {"version": FORMAT, "header_crc32": header_crc32(header)}
    Metadata(name=FORMAT_RECORD, metadata=about).write(records)
    Metadata(name=HEADER_RECORD, metadata=header).write(records)
    found = parts(data)[1]
    changed = data[: found[FORMAT_RECORD][0]] + records.end() + data[found[HEADER_RECORD][1] :]
    place = chunk_of(data, 5) + 200 + len(changed) - len(data)
    recovered = saved(tmp_path, broken(changed, place))
    assert recovered.header_lost
    assert "its header does not describe its topics and was left out" in recovered.notes
    assert len(read_log(tmp_path / "good.mcap")["/joint"]) == N_CYCLES - 1


def test_a_recovered_log_that_is_damaged_keeps_earlier_losses(tmp_path: Path, data: bytes) -> None:
    first = saved(tmp_path, broken(data, chunk_of(data, 5) + 200))
    again = (tmp_path / "good.mcap").read_bytes()
    second = saved(tmp_path, broken(again, chunk_of(again, 9) + 200))
    assert second.lost[: len(first.lost)] == first.lost
    assert len(second.lost) == 2 * len(first.lost)


def test_recovering_twice_gives_the_same_values(tmp_path: Path, data: bytes) -> None:
    saved(tmp_path, broken(data, chunk_of(data, 5) + 200))
    once = read_log(tmp_path / "good.mcap")
    saved(tmp_path, (tmp_path / "good.mcap").read_bytes())
    twice = read_log(tmp_path / "good.mcap")
    assert all(packets.tobytes() == twice[topic].tobytes() for topic, packets in once.packets.items())


@pytest.mark.parametrize(
    ("content", "why"),
    [(b"", "nothing can be saved"), (b"tick,angle_rad\n0,0.5\n", "nothing can be saved")],
    ids=["empty", "foreign"],
)
def test_what_is_no_log_cannot_be_recovered(tmp_path: Path, content: bytes, why: str) -> None:
    with pytest.raises(LogNotReadable, match=why):
        saved(tmp_path, content)
    assert not (tmp_path / "good.mcap").exists()


def test_a_later_format_cannot_be_recovered(tmp_path: Path, data: bytes) -> None:
    later = bytearray(data)
    later[data.index(b"version") + len(b"version") + 4] = ord("9")
    with pytest.raises(LogNotReadable, match="log format 9"):
        saved(tmp_path, bytes(later))


def test_a_log_is_not_recovered_into_itself(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "run.mcap").write_bytes(data)
    with pytest.raises(BadRequest, match="is the file of BAD too"):
        recover(tmp_path / "run.mcap", tmp_path / "run.mcap", lambda *_: None)
    assert (tmp_path / "run.mcap").read_bytes() == data


@pytest.mark.parametrize("kept", [1.0, 0.6], ids=["closed", "cut short"])
def test_bits_flipped_anywhere(tmp_path: Path, data: bytes, kept: float) -> None:
    found = flip_bits(original(data[: int(kept * len(data))]), 60, 6, tmp_path)
    assert found["wrong"] == []
    assert found["read"]["detected"] > 20


def test_files_cut_anywhere(tmp_path: Path, data: bytes) -> None:
    found = truncate_file(original(data), CUT_EVERY // 4, tmp_path)
    assert found["wrong"] == []
    assert found["read"]["cut"] > 5

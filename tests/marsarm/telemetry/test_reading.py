"""Reading of logs: parts by topic and time, and damage: truncated files, flipped bits, foreign files."""

import json
import os
import struct
from collections.abc import Iterable
from pathlib import Path

import pytest
from mcap.writer import Writer

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
from marsarm.telemetry.recover import recover
from simgap.common.progress import no_progress
from tests.marsarm.telemetry.lab import cycle_at, record

N_CYCLES = 30
LAYOUT = [["angle_rad", "<f8", None]]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("part")
    return record(folder / "run.mcap", map(cycle_at, range(N_CYCLES)), chunk_cycles=1)


def test_only_the_topics_asked_for_are_there(path: Path) -> None:
    log = read_log(path, topics=["/joint", "/evr"])
    assert (set(log.packets), set(log.time_ns)) == ({"/joint"}, {"/joint", "/evr"})
    assert (len(log.evrs), len(log.commands)) == (2 * N_CYCLES, 0)


@pytest.mark.parametrize(
    ("start", "end"), [(0, N_CYCLES), (7, 19), (7, None), (None, 19), (12, 13), (N_CYCLES, None), (5, 5)]
)
@pytest.mark.parametrize("kept", [1.0, 0.99], ids=["closed", "cut short"])
def test_only_the_time_asked_for_is_there(
    path: Path, tmp_path: Path, start: int | None, end: int | None, kept: float
) -> None:
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


def test_what_unpacks_to_more_than_is_read_at_once_is_read_in_parts(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_the_header_says_what_the_messages_are_and_others_are_passed_over(tmp_path: Path) -> None:
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
def test_times_that_do_not_go_forward_are_refused(
    tmp_path: Path, times_ns: tuple[int, ...], why: str
) -> None:
    messages = [("/a", k, time_ns, 0.5) for k, time_ns in enumerate(times_ns)]
    topics = {"/a": {"id": 1, "schema": "s", "layout": LAYOUT, "truth": False, "derived": False}}
    with pytest.raises(LogDamaged, match=why):
        read_log(written(tmp_path / "times.mcap", messages, {"channels": json.dumps(topics)}))


def test_a_header_that_announces_nonsense_is_refused(tmp_path: Path) -> None:
    for nonsense in ("[1]", "{", '{"/a": 1}', '{"/a": {"id": 1, "layout": [["x", "O", null]]}}'):
        with pytest.raises(LogDamaged):
            read_log(written(tmp_path / "n.mcap", [("/a", 0, 5, 0.5)], {"channels": nonsense}))


def test_a_log_whose_last_chunk_is_whole_but_whose_length_is_not_is_not_taken_for_cut(
    path: Path, tmp_path: Path
) -> None:
    data = path.read_bytes()
    begins = [at for at, _ in read_records(data).chunks]
    cut = bytearray(data[: begins[-1] - 1])
    cut[begins[-2] + 6] ^= 0x10  # of the length of the last chunk
    (tmp_path / "cut.mcap").write_bytes(cut)
    with pytest.raises(LogDamaged, match="a record is broken"):
        read_log(tmp_path / "cut.mcap")


@pytest.fixture(scope="module")
def log_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    return record(path, map(cycle_at, range(12)), chunk_cycles=1).read_bytes()


def test_a_chunk_taken_out_is_missed(tmp_path: Path, log_bytes: bytes) -> None:
    chunks = [at for at, _ in read_records(log_bytes).chunks]
    without_second = log_bytes[: chunks[1]] + log_bytes[chunks[2] : chunks[4]]
    (tmp_path / "short.mcap").write_bytes(without_second)
    with pytest.raises(LogDamaged, match="missing or out of order"):
        read_log(tmp_path / "short.mcap")


def test_a_foreign_mcap_is_not_our_log(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    writer = Writer(str(path))
    writer.start()
    writer.add_message(writer.register_channel("/a", "json", 0), 0, b"{}", 0)
    writer.finish()
    with pytest.raises(LogNotReadable, match="not a marsarm log"):
        read_log(path)


def test_a_file_larger_than_any_log_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "sparse.mcap"
    path.touch()
    os.truncate(path, 30 << 30)
    with pytest.raises(LogNotReadable, match="has 32212254720 bytes, more than 4294967296"):
        read_log(path)

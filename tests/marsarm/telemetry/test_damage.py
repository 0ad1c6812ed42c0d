"""Reading of damaged logs: killed writer, truncated file, flipped bits, foreign file."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, Writer

from marsarm.telemetry.errors import LogError, LogNotReadable
from marsarm.telemetry.lost_messages import LogDamaged
from marsarm.telemetry.mcap_reader import iter_records
from marsarm.telemetry.read import Log, read_log

ROOT = Path(__file__).parents[3]
N_CYCLES = 12


@pytest.fixture(scope="module")
def log_bytes(make: Any, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = make.record(
        tmp_path_factory.mktemp("log") / "run.mcap", map(make.cycle_at, range(N_CYCLES)), chunk_s=0.0
    )
    return path.read_bytes()


def read_back(path: Path, data: bytes) -> Log:
    path.write_bytes(data)
    return read_log(path)


def is_start_of(log: Log, whole: Log) -> bool:
    """Return whether a log holds only written messages, in order, with at most its end missing."""
    same_packets = all(p.tobytes() == whole[t][: len(p)].tobytes() for t, p in log.packets.items())
    same_times = all(np.array_equal(ns, whole.time_ns[t][: len(ns)]) for t, ns in log.time_ns.items())
    same_events = (
        log.evrs == whole.evrs[: len(log.evrs)] and log.commands == whole.commands[: len(log.commands)]
    )
    return same_packets and same_times and same_events and log.header == whole.header


@pytest.mark.parametrize("chunk_s", [0.0, 0.01])
def test_a_killed_writer_leaves_all_closed_chunks(make: Any, tmp_path: Path, chunk_s: float) -> None:
    path = tmp_path / "run.mcap"
    program = [sys.executable, make.__file__, str(path), str(chunk_s)]
    with subprocess.Popen(
        program, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": str(ROOT)}
    ) as writer:
        assert writer.stdout is not None
        assert next(int(line) for line in writer.stdout if int(line) >= 300)
        os.kill(writer.pid, signal.SIGKILL)
    log = read_log(path)
    assert log.truncated
    assert log.header["seed"] == "1"
    n = len(log["/truth"])
    assert n > 0
    for tick in (0, n // 2, n - 1):
        assert (
            log["/sensors"][tick]["resolver_rad"].tobytes()
            == make.cycle_at(tick).sensors.resolver_rad.tobytes()
        )


@pytest.mark.slow
def test_a_log_cut_anywhere_gives_its_start_and_says_so(tmp_path: Path, log_bytes: bytes) -> None:
    whole = read_back(tmp_path / "whole.mcap", log_bytes)
    headless = 0
    for size in range(0, len(log_bytes), 13):
        try:
            log = read_back(tmp_path / "cut.mcap", log_bytes[:size])
        except LogNotReadable:
            headless = size
        else:
            assert log.truncated
            assert is_start_of(log, whole)
    assert headless < 4096


@pytest.mark.slow
@pytest.mark.parametrize("kept", [1.0, 0.6], ids=["closed", "cut short"])
def test_no_flipped_bit_gives_a_wrong_value(tmp_path: Path, log_bytes: bytes, kept: float) -> None:
    whole = read_back(tmp_path / "whole.mcap", log_bytes)
    data = log_bytes[: int(kept * len(log_bytes))]
    random = np.random.default_rng(6)
    detected = 0
    for at, bit in zip(random.integers(len(data), size=1000), random.integers(8, size=1000), strict=True):
        flipped = bytearray(data)
        flipped[at] ^= 1 << int(bit)
        try:
            assert is_start_of(read_back(tmp_path / "flipped.mcap", bytes(flipped)), whole), (
                f"bit {bit} of byte {at}"
            )
        except LogError:
            detected += 1
    assert detected > 500


def test_a_flipped_bit_in_a_chunk_is_reported_with_its_place(tmp_path: Path, log_bytes: bytes) -> None:
    flipped = bytearray(log_bytes)
    at = len(log_bytes) // 3
    flipped[at] ^= 1
    with pytest.raises(
        LogDamaged,
        match=r"\(byte \d+\); the file was changed after it was written, and `marsarm log recover`",
    ) as caught:
        read_back(tmp_path / "flipped.mcap", bytes(flipped))
    assert 0 < caught.value.offset <= at


def test_a_chunk_taken_out_is_missed(tmp_path: Path, log_bytes: bytes) -> None:
    chunks = [at for at, opcode, _ in iter_records(log_bytes, len(MCAP0_MAGIC)) if opcode == Opcode.CHUNK]
    without_second = log_bytes[: chunks[1]] + log_bytes[chunks[2] : chunks[4]]
    with pytest.raises(LogDamaged, match="missing or out of order"):
        read_back(tmp_path / "short.mcap", without_second)


def test_an_empty_file_is_not_a_log(tmp_path: Path) -> None:
    with pytest.raises(LogNotReadable, match="empty file"):
        read_back(tmp_path / "empty.mcap", b"")


def test_a_foreign_file_is_not_a_log(tmp_path: Path) -> None:
    with pytest.raises(LogNotReadable, match="not an MCAP file"):
        read_back(tmp_path / "notes.txt", b"tick,angle_rad\n0,0.5\n")


def test_a_foreign_mcap_is_not_our_log(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    writer = Writer(str(path))
    writer.start()
    writer.add_message(writer.register_channel("/a", "json", 0), 0, b"{}", 0)
    writer.finish()
    with pytest.raises(LogNotReadable, match="not a marsarm log"):
        read_log(path)


def test_a_log_of_a_later_format_is_refused_by_number(tmp_path: Path) -> None:
    path = tmp_path / "later.mcap"
    writer = Writer(str(path))
    writer.start()
    writer.add_metadata("marsarm.format", {"version": "3"})
    writer.finish()
    with pytest.raises(LogNotReadable, match="log format 3; this marsarm reads format 2"):
        read_log(path)


@pytest.mark.parametrize("name", ["pipe", ".", "/dev/zero"])
def test_only_a_regular_file_is_read(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LogNotReadable, match="is not a regular file"):
        read_log(tmp_path / name)


def test_a_file_larger_than_any_log_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "sparse.mcap"
    path.touch()
    os.truncate(path, 30 << 30)
    with pytest.raises(LogNotReadable, match="has 32212254720 bytes; a log has at most 4294967296"):
        read_log(path)


@pytest.mark.parametrize("name", ["missing.mcap", "nul\0.mcap"])
def test_a_file_that_cannot_be_read_is_reported(tmp_path: Path, name: str) -> None:
    with pytest.raises(LogNotReadable, match="cannot be read"):
        read_log(f"{tmp_path}/{name}")

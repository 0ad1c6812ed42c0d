"""The thread that writes: nothing that it took is lost, and nothing that happens to it goes untold."""

import errno
import gc
import json
import os
import subprocess
import sys
from collections import deque
from io import FileIO
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC, IndexType, Writer

from ground.telemetry.container import records
from ground.telemetry.read import read_log
from ground.telemetry.record import Recorder

ROOT = Path(__file__).parents[3]


class SmallDisk(FileIO):
    """A file on a disk with room for 20 kB more than what a log begins with, which writes in small bites."""

    room = 30_000

    def write(self, data: Any) -> int:
        if self.tell() >= self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data[: min(3000, self.room - self.tell())])


def python(program: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a program that knows this tree; warnings are errors, but for the one of a fork beside threads."""
    fork = "ignore:This process:DeprecationWarning"
    return subprocess.run(
        [sys.executable, "-W", "error", "-W", fork, "-c", program, *words],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


BEGIN = """\
import os, sys, time
from ground.telemetry.record import Recorder
from tests.ground.telemetry.conftest import cycle_at
recorder = Recorder(sys.argv[1], {})
for tick in range(40):
    recorder.write(cycle_at(tick))
"""


def test_a_recorder_that_nobody_closes_is_closed_at_the_end_of_the_program(tmp_path: Path) -> None:
    done = python(BEGIN, str(tmp_path / "run.mcap"))
    assert (done.returncode, done.stderr) == (0, "")
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (40, False)


def test_a_recorder_that_is_let_go_closes_itself(make: Any, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", {})
    recorder.write(make.cycle_at(0))
    del recorder
    gc.collect()
    assert not read_log(tmp_path / "run.mcap").truncated


@pytest.mark.parametrize("ending", ["sys.exit()", "os._exit(0)", "recorder.close(); os._exit(0)"])
def test_a_forked_process_leaves_the_log_alone(tmp_path: Path, ending: str) -> None:
    program = f"""{BEGIN}
child = os.fork()
if child == 0:
    try:
        recorder.write(cycle_at(40))
    except RuntimeError as error:
        print(error, flush=True)
    {ending}
os.waitpid(child, 0)
recorder.write(cycle_at(40))
recorder.close()
"""
    done = python(program, str(tmp_path / "run.mcap"))
    assert (done.returncode, done.stderr) == (0, "")
    assert "written by the process that opened it" in done.stdout
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (41, False)


def test_a_full_disk_is_told_by_the_next_cycle_and_by_the_end(
    make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ground.telemetry.record.FileIO", SmallDisk)
    path = tmp_path / "run.mcap"
    recorder = Recorder(path, {})
    with pytest.raises(OSError, match="No space left"):
        deque(map(recorder.write, map(make.cycle_at, count())), maxlen=0)
    with pytest.raises(OSError, match="No space left"):
        recorder.close()
    recorder.close()
    log = read_log(path)
    assert log.truncated
    assert len(log["/joint"]) == recorder.written_cycles > 0
    ends = [at + 9 + len(body) for at, _, body in records(path.read_bytes(), len(MCAP0_MAGIC))]
    assert ends[-1] == path.stat().st_size, "half a record is left"


def test_a_disk_that_is_full_at_the_end_is_told_by_close(
    make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = make.record(tmp_path / "whole.mcap", [make.cycle_at(0)]).stat().st_size
    monkeypatch.setattr("ground.telemetry.record.FileIO", SmallDisk)
    monkeypatch.setattr(SmallDisk, "room", whole - 10)
    recorder = Recorder(tmp_path / "run.mcap", {"seed": "1", "arm": "nominal"})
    recorder.write(make.cycle_at(0))
    with pytest.raises(OSError, match="No space left"):
        recorder.close()
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), recorder.written_cycles, log.truncated) == (1, 1, True)


def test_the_container_is_that_of_the_stock_writer(make: Any, tmp_path: Path) -> None:
    path = make.record(tmp_path / "run.mcap", map(make.cycle_at, range(30)), chunk_s=0.0)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary, messages = reader.get_summary(), list(reader.iter_messages(log_time_order=False))
    assert summary is not None
    stock = tmp_path / "stock.mcap"
    writer = Writer(str(stock), enable_data_crcs=True, index_types=IndexType.ALL)
    writer.start()
    for schema in summary.schemas.values():
        writer.register_schema(schema.name, schema.encoding, schema.data)
    for channel in summary.channels.values():
        writer.register_channel(channel.topic, channel.message_encoding, channel.schema_id, channel.metadata)
    for _, _, message in messages:
        writer.add_message(
            message.channel_id, message.log_time, message.data, message.publish_time, message.sequence
        )
    writer.finish()
    with stock.open("rb") as file:
        told = make_reader(file).get_summary()
    assert told is not None
    assert summary.schemas == told.schemas
    assert summary.channels == told.channels
    ours, theirs = summary.statistics, told.statistics
    assert ours is not None
    assert theirs is not None
    for name in ("message_count", "channel_message_counts", "message_start_time", "message_end_time",
                 "schema_count", "channel_count"):  # fmt: skip
        assert getattr(ours, name) == getattr(theirs, name), name
    assert (ours.chunk_count, ours.metadata_count, len(summary.metadata_indexes)) == (31, 2, 2)
    found = [opcode for _, opcode, _ in records(path.read_bytes(), len(MCAP0_MAGIC))]
    assert found[:4] == [Opcode.HEADER, Opcode.METADATA, Opcode.METADATA, Opcode.CHUNK]
    assert found.count(Opcode.MESSAGE_INDEX) == sum(
        len(c.message_index_offsets) for c in summary.chunk_indexes
    )


@pytest.mark.slow
def test_killed_process_groups_leave_nothing_wrong() -> None:
    done = python("import json; from benchmarks.killed import killed; print(json.dumps(killed(5, 3)))")
    assert done.returncode == 0, done.stderr
    outcomes = json.loads(done.stdout)["outcomes"]
    assert outcomes["wrong"] == 0
    assert outcomes["open"] == 5

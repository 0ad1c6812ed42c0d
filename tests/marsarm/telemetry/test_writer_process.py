"""The writing process: it loses no row that it received, and every failure is reported."""

import gc
import json
import os
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from itertools import count, cycle
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC, IndexType, Writer

from marsarm.telemetry.errors import LogNotWritable
from marsarm.telemetry.mcap_reader import iter_records
from marsarm.telemetry.mcap_writer import LogRow
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.ros_messages import JointSample
from marsarm.telemetry.writer_pipe import encode_row
from marsarm.telemetry.writer_process import RowStream, encode_end
from validation import killed
from validation.campaigns import Context
from validation.killed import Kill

ROOT = Path(__file__).parents[3]


class Pieces:
    """Pipe that delivers bytes in pieces of given sizes, repeated in turn."""

    def __init__(self, data: bytes, sizes: Sequence[int]) -> None:
        self._data, self._sizes = BytesIO(data), cycle(sizes)

    def read1(self, most: int, /) -> bytes:
        return self._data.read(min(most, next(self._sizes)))


def python(program: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a program on this tree; all warnings are errors except that of a fork with threads."""
    fork = "ignore:This process:DeprecationWarning"
    return subprocess.run(
        [sys.executable, "-W", "error", "-W", fork, "-c", program, *words],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip


BEGIN = """\
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it for background processes
from marsarm.telemetry.recorder import Recorder
from tests.marsarm.telemetry.conftest import cycle_at
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


def test_a_cycle_after_the_end_of_the_log_is_refused(make: Any, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", {})
    recorder.write(make.cycle_at(0))
    recorder.close()
    with pytest.raises(ValueError, match="the log is closed"):
        recorder.write(make.cycle_at(1))
    assert len(read_log(tmp_path / "run.mcap")["/joint"]) == 1


@pytest.mark.parametrize("tick", [2, 3])
def test_a_log_goes_forward(make: Any, tmp_path: Path, tick: int) -> None:
    with Recorder(tmp_path / "run.mcap", {}) as recorder:
        recorder.write(make.cycle_at(3))
        with pytest.raises(ValueError, match=f"cycle {tick} after cycle 3"):
            recorder.write(make.cycle_at(tick))
        recorder.write(make.cycle_at(5))
    assert read_log(tmp_path / "run.mcap").ticks("/joint").tolist() == [3, 5]


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


SMALL_DISK = """\
import resource, sys
from marsarm.telemetry.recorder import Recorder
from tests.marsarm.telemetry.conftest import cycle_at
resource.setrlimit(resource.RLIMIT_FSIZE, 2 * (int(sys.argv[2]),))
recorder = Recorder(sys.argv[1], {"seed": "1", "arm": "nominal"})
try:
    for tick in range(int(sys.argv[3])):
        recorder.write(cycle_at(tick))
except OSError as error:
    print("cycle:", error.strerror)
try:
    recorder.close()
except OSError as error:
    print("end:", error.strerror)
recorder.close()
print(recorder.written_cycles)
"""
"""Arguments: path, bytes that fit on the disk, cycles to record."""


def test_a_full_disk_is_reported_by_a_later_cycle_and_by_close(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    done = python(SMALL_DISK, str(path), "30000", "100000")
    assert (done.returncode, done.stderr) == (0, "")
    *errors, written = done.stdout.splitlines()
    assert errors == ["cycle: File too large", "end: File too large"]
    log = read_log(path)
    assert log.truncated
    assert len(log["/joint"]) == int(written) > 0
    ends = [at + 9 + len(body) for at, _, body in iter_records(path.read_bytes(), len(MCAP0_MAGIC))]
    assert ends[-1] == path.stat().st_size, "half a record is left"


def test_a_disk_that_is_full_at_the_end_is_reported_by_close(make: Any, tmp_path: Path) -> None:
    whole = make.record(tmp_path / "whole.mcap", [make.cycle_at(0)]).stat().st_size
    done = python(SMALL_DISK, str(tmp_path / "run.mcap"), str(whole - 10), "1")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["end: File too large", "1"]
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (1, True)


@pytest.mark.parametrize("ending", ["os.kill(os.getpid(), 9)", "os._exit(0)"])
def test_rows_that_were_sent_outlive_the_run(tmp_path: Path, ending: str) -> None:
    """All rows are written without a message; the log is truncated, since nobody closed it."""
    done = python(f"{BEGIN}{ending}\n", str(tmp_path / "run.mcap"))
    assert done.stderr == ""
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (40, True)


def test_an_interrupt_of_the_whole_group_ends_the_log_as_it_should(tmp_path: Path) -> None:
    ending = "try:\n    os.killpg(os.getpid(), signal.SIGINT)\n    time.sleep(9)\n"
    program = f"import os\nos.setsid()\n{BEGIN}{ending}except KeyboardInterrupt:\n    pass\n"
    done = python(program, str(tmp_path / "run.mcap"))
    assert (done.returncode, done.stderr) == (0, "")
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (40, False)


@pytest.mark.parametrize("closed", [(0,), (1,), (0, 1), (0, 1, 2)], ids=str)
def test_a_run_whose_standard_streams_are_closed_has_its_log(tmp_path: Path, closed: Sequence[int]) -> None:
    """The first file that such a run opens has the number of a standard stream."""
    closing = "".join(f"os.close({one})\n" for one in closed)
    imports, rest = BEGIN.split("recorder =")
    python(f"{imports}{closing}recorder ={rest}recorder.close()\nos._exit(0)\n", str(tmp_path / "run.mcap"))
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (40, False)


def test_the_writer_is_of_the_code_of_the_run_wherever_that_works(tmp_path: Path) -> None:
    """The run starts in the folder of the code, and changes to a folder with another `ground`."""
    (tmp_path / "ground").mkdir()
    (tmp_path / "ground" / "__init__.py").write_text("raise SystemExit('not this one')")
    done = subprocess.run(
        [sys.executable, "-c", f"{BEGIN.replace('recorder =', 'os.chdir(sys.argv[2]); recorder =')}"
         "recorder.close()", str(tmp_path / "run.mcap"), str(tmp_path)],
        cwd=ROOT, env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"},
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert len(read_log(tmp_path / "run.mcap")["/joint"]) == 40


def test_a_python_that_says_something_when_it_starts_writes_logs(
    make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text("print('hello', end='')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    make.record(tmp_path / "run.mcap", [make.cycle_at(0)])
    assert len(read_log(tmp_path / "run.mcap")["/joint"]) == 1


@pytest.mark.parametrize("python_of_the_run", ["/nowhere/python", "/bin/false"])
def test_without_a_process_to_write_it_the_log_that_was_there_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, python_of_the_run: str
) -> None:
    (tmp_path / "run.mcap").write_text("of a good day")
    monkeypatch.setattr(sys, "executable", python_of_the_run)
    with pytest.raises(LogNotWritable, match="no process to write it"):
        Recorder(tmp_path / "run.mcap", {})
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("run.mcap", "of a good day")]


def test_no_cycle_follows_one_that_was_interrupted_on_its_way(make: Any, tmp_path: Path) -> None:
    def interrupt(*_: object) -> None:
        raise InterruptedError

    some, recorder = make.cycle_at(0), Recorder(tmp_path / "run.mcap", {})
    before = signal.signal(signal.SIGALRM, interrupt)
    os.kill(recorder.writer_process, signal.SIGSTOP)
    try:
        signal.setitimer(signal.ITIMER_REAL, 1.0)  # when the pipe is full
        with pytest.raises(InterruptedError):
            deque((recorder.write(replace(some, tick=tick)) for tick in count()), maxlen=0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        os.kill(recorder.writer_process, signal.SIGCONT)
    with pytest.raises(ValueError, match="interrupted on its way"):
        recorder.write(replace(some, tick=10**6))
    recorder.close()
    log = read_log(tmp_path / "run.mcap")
    assert log.truncated
    assert len(log["/joint"]) > 10


def test_an_interrupt_while_the_log_is_opened_leaves_nothing_and_is_reported_once(tmp_path: Path) -> None:
    imports, rest = BEGIN.split("recorder =")
    program = f"""{imports}
import signal
os.setsid()
signal.signal(signal.SIGALRM, lambda *_: os.killpg(os.getpid(), signal.SIGINT))
signal.setitimer(signal.ITIMER_REAL, 0.03)  # the writer takes ten times as long to start
recorder ={rest}"""
    done = python(program, str(tmp_path / "run.mcap"))
    assert done.stderr.count("Traceback") == 1
    assert done.stderr.endswith("KeyboardInterrupt\n")
    assert list(tmp_path.iterdir()) == []


def test_a_writer_that_is_killed_is_reported_like_a_disk_that_is_gone(make: Any, tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", {})
    os.kill(recorder.writer_process, signal.SIGKILL)
    with pytest.raises(OSError, match="the process that wrote it was killed by signal 9"):
        deque(map(recorder.write, map(make.cycle_at, count())), maxlen=0)
    with pytest.raises(OSError, match="killed by signal 9"):
        recorder.close()
    assert read_log(tmp_path / "run.mcap").truncated


@given(st.lists(st.integers(1, 3000), min_size=1), st.booleans())
def test_rows_are_the_same_in_whatever_pieces_they_come(sizes: list[int], complete: bool) -> None:
    rows = [LogRow(tick, bytes([tick]) * (tick + 1)) for tick in range(30)]
    sample = JointSample([0.0] * 5, [1.0] * 5, [2.0] * 5)
    sent = b"".join(encode_row(*row, sample if row.time_ns % 8 == 0 else None) for row in rows)
    sent += encode_end("") if complete else sent[:10]
    stream, taken, goes_on = RowStream(Pieces(sent, sizes)), [], True
    while goes_on:
        some, goes_on = stream.take()
        taken += some
    assert [row for row, _ in taken] == rows
    assert [one for _, one in taken] == [sample if row.time_ns % 8 == 0 else None for row in rows]
    assert stream.is_complete == complete


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
        expected = make_reader(file).get_summary()
    assert expected is not None
    assert summary.schemas == expected.schemas
    assert summary.channels == expected.channels
    ours, theirs = summary.statistics, expected.statistics
    assert ours is not None
    assert theirs is not None
    for name in ("message_count", "channel_message_counts", "message_start_time", "message_end_time",
                 "schema_count", "channel_count"):  # fmt: skip
        assert getattr(ours, name) == getattr(theirs, name), name
    assert (ours.chunk_count, ours.metadata_count, len(summary.metadata_indexes)) == (31, 2, 2)
    found = [opcode for _, opcode, _ in iter_records(path.read_bytes(), len(MCAP0_MAGIC))]
    assert found[:4] == [Opcode.HEADER, Opcode.METADATA, Opcode.METADATA, Opcode.CHUNK]
    assert found.count(Opcode.MESSAGE_INDEX) == sum(
        len(c.message_index_offsets) for c in summary.chunk_indexes
    )


@pytest.mark.slow
def test_killed_process_groups_leave_nothing_wrong() -> None:
    done = python(
        "import json; from validation.campaigns import Context; from validation.killed import campaign;"
        "print(json.dumps(campaign(Context(3), 5)))"
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["kills"], found["outcomes"]["cut short"], found["wrong"]) == (5, 5, [])


@pytest.mark.parametrize(
    ("outcomes", "in_bounds"),
    [
        ([Kill("cut short", 0.019), Kill("closed"), Kill("cut short", 0.001)], True),
        ([Kill("cut short", 0.021), Kill("cut short", 0.001)], False),
        ([Kill("wrong: not what the run was"), Kill("cut short", 0.001)], False),
        ([Kill("closed"), Kill("cut short", 0.001)], False),
    ],
    ids=["all is well", "too much is lost", "a log is wrong", "too few logs were open"],
)
def test_a_campaign_of_kills_ends_with_its_verdict(
    outcomes: list[Kill], in_bounds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(killed, "kill_runs", lambda number, seed: outcomes)
    assert killed.campaign(Context(), 2)["in_bounds"] is in_bounds

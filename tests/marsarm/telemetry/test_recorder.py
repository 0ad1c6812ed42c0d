"""Recording: paths where a log can be written, what interrupts it, and logging of every EVR and command."""

import json
import os
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from io import FileIO
from mmap import mmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import MoveJoint
from fsw.dictionary.enums import Joint
from helpers.command import run_python
from marsarm.replaying.replay import ReplayRequest, replay
from marsarm.telemetry.format import CHUNK_CYCLES, LogNotWritable
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import Recorder, record_commands
from marsarm.telemetry.recover import recover
from sim.arms import BuiltArm, arm_named
from sim.initialisation import start_loop
from tests.marsarm.command import ROOT, largest_file
from tests.marsarm.telemetry.lab import cycle_at, record


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("missing/run.mcap", "there is no folder .*missing"),
        ("", "this is a folder; name a file in it"),
        ("nul\0.mcap", "cannot be written"),
        ("x" * 300, "cannot be written"),
        ("file/run.mcap", "there is no folder"),
        ("pipe", "is not a regular file"),
    ],
    ids=["no directory", "a directory", "zero byte", "too long", "below a file", "a pipe"],
)
def test_a_path_that_cannot_be_written_is_refused_and_left_as_it_was(tmp_path, name, why):
    (tmp_path / "file").write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LogNotWritable, match=why) as caught:
        Recorder(f"{tmp_path}/{name}", {})
    assert caught.value.path == Path(f"{tmp_path}/{name}")
    assert {p.name for p in tmp_path.rglob("*")} == {"file", "pipe"}
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_directory_without_permission_is_refused(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(LogNotWritable, match="no right to write there"):
        Recorder(tmp_path / "run.mcap", {})


@pytest.mark.parametrize("before", [{}, {"run.mcap": b"of a good day"}], ids=["new", "over another"])
def test_a_disk_without_room_is_refused_and_leaves_what_was_there(tmp_path, before):
    for name, data in before.items():
        (tmp_path / name).write_bytes(data)
    with largest_file(0), pytest.raises(LogNotWritable, match="File too large"):
        Recorder(tmp_path / "run.mcap", {})
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == before


def test_a_log_is_written_where_a_link_points_to(tmp_path):
    (tmp_path / "last.mcap").symlink_to("run.mcap")
    record(tmp_path / "last.mcap", [cycle_at(0)])
    assert (tmp_path / "last.mcap").is_symlink()
    assert len(read_log(tmp_path / "run.mcap")["/sensors"]) == 1


def record_and_end(
    path: Path, cycles: int, end: Callable[[Recorder], object], closed: Sequence[int] = ()
) -> int:
    """Record in a fork of this process, without these streams; return its wait status."""
    child = os.fork()
    if child == 0:
        try:
            for stream in closed:
                os.close(stream)
            recorder = Recorder(path, {})
            for tick in range(cycles):
                recorder.write(cycle_at(tick))
            end(recorder)
        finally:
            os._exit(1)
    return os.waitpid(child, 0)[1]


forks = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")


def test_a_cycle_after_the_end_of_the_log_is_refused(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap", {})
    recorder.write(cycle_at(0))
    recorder.close()
    with pytest.raises(ValueError, match="the log is closed"):
        recorder.write(cycle_at(1))
    assert len(read_log(tmp_path / "run.mcap")["/joint"]) == 1


@pytest.mark.parametrize("tick", [2, 3])
def test_a_log_goes_forward(tmp_path, tick):
    with Recorder(tmp_path / "run.mcap", {}) as recorder:
        recorder.write(cycle_at(3))
        with pytest.raises(ValueError, match=f"cycle {tick} after cycle 3"):
            recorder.write(cycle_at(tick))
        recorder.write(cycle_at(5))
    assert read_log(tmp_path / "run.mcap").ticks("/joint").tolist() == [3, 5]


@pytest.mark.slow
def test_a_forked_process_leaves_a_log_alone_that_the_end_of_the_program_closes(tmp_path):
    program = """
import os, sys
from marsarm.telemetry.recorder import Recorder
from tests.marsarm.telemetry.lab import cycle_at
recorder = Recorder(sys.argv[1], {})
for tick in range(40):
    recorder.write(cycle_at(tick))
def close_and_end():
    recorder.close()
    os._exit(0)
for end in (sys.exit, close_and_end):
    child = os.fork()
    if child == 0:
        try:
            recorder.write(cycle_at(40))
        except RuntimeError as error:
            print(error, flush=True)
        end()
    os.waitpid(child, 0)
recorder.write(cycle_at(40))
"""
    warnings = ("-W", "error", "-W", "ignore:This process:DeprecationWarning")  # a fork with threads
    done = run_python(tmp_path, *warnings, "-c", program, "run.mcap", PYTHONPATH=str(ROOT))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("written by the process that opened it") == 2
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (41, False)


def record_on_disk(path: Path, size: int, cycles: int) -> tuple[list[str | None], int]:
    """Record on a disk of this size in bytes; return the errors of cycles and end, and cycles written."""
    errors = []
    with largest_file(size):
        recorder = Recorder(path, {"seed": "1", "arm": "nominal"})
        for work in (lambda: [recorder.write(cycle_at(tick)) for tick in range(cycles)], recorder.close):
            try:
                work()
                errors.append(None)
            except OSError as error:
                errors.append(error.strerror)
        recorder.close()
    return errors, recorder.written_cycles


def test_a_full_disk_is_reported_by_a_later_cycle_and_by_close(tmp_path):
    errors, written = record_on_disk(tmp_path / "run.mcap", 300_000, 100_000)
    assert errors == ["File too large", "File too large"]
    log = read_log(tmp_path / "run.mcap")
    assert log.truncated
    assert len(log["/joint"]) == written > 0


def test_a_disk_that_is_full_at_the_end_is_reported_by_close(tmp_path):
    whole = record(tmp_path / "whole.mcap", [cycle_at(0)]).stat().st_size
    assert record_on_disk(tmp_path / "run.mcap", whole - 10, 1) == ([None, "File too large"], 1)
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (1, True)


@forks
def test_a_killed_run_loses_less_than_a_chunk(tmp_path):
    assert record_and_end(tmp_path / "run.mcap", 150, lambda _: os.kill(os.getpid(), 9)) == 9
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (128, True)


@pytest.mark.slow
@forks
def test_runs_killed_at_random_times_leave_what_is_older_than_a_chunk(tmp_path):
    rng, path, good = np.random.default_rng(54), tmp_path / "run.mcap", tmp_path / "good.mcap"
    cycles, written = [cycle_at(tick) for tick in range(64)], np.frombuffer(mmap(-1, 8), np.int64)
    for _ in range(50):
        written[0], kill_at = 0, rng.integers(CHUNK_CYCLES, 3 * CHUNK_CYCLES)
        child = os.fork()
        if child == 0:
            try:
                recorder = Recorder(path, {})
                while True:
                    recorder.write(replace(cycles[written[0] % 64], tick=int(written[0])))
                    written[0] += 1
            finally:
                os._exit(1)
        while written[0] <= kill_at:
            assert os.waitpid(child, os.WNOHANG) == (0, 0)
            time.sleep(1e-4)
        os.kill(child, 9)
        os.waitpid(child, 0)
        log = read_log(path)
        recover(path, good, lambda *_: None)
        assert log.truncated
        assert len(read_log(good)["/joint"]) == len(log["/joint"])
        assert written[0] - len(log["/joint"]) <= 1.2 * CYCLE_HZ


def test_an_interrupt_within_a_write_leaves_a_log_that_ends_there(tmp_path, monkeypatch):
    class HalfFile(FileIO):
        def write(self, data: Any) -> int:
            if len(data) < 2000:
                return super().write(data)
            super().write(data[:1000])
            raise KeyboardInterrupt

    recorder = Recorder(tmp_path / "run.mcap", {}, chunk_cycles=1)
    recorder.write(cycle_at(0))
    file = recorder._log._file
    monkeypatch.setattr(recorder._log, "_file", HalfFile(os.dup(file.fileno()), "wb"))
    with pytest.raises(KeyboardInterrupt):
        recorder.write(replace(cycle_at(1), commands=cycle_at(1).commands * 100))
    with pytest.raises(OSError, match="an earlier part of it could not be written"):
        recorder.write(cycle_at(2))
    recorder.close()
    file.close()
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (1, True)


@forks
@pytest.mark.parametrize("closed", [(1,), (0, 1, 2)], ids=str)
def test_a_run_whose_standard_streams_are_closed_has_its_log(tmp_path, closed):
    """The first file that such a run opens has the number of a standard stream."""
    record_and_end(tmp_path / "run.mcap", 40, Recorder.close, closed)
    log = read_log(tmp_path / "run.mcap")
    assert (len(log["/joint"]), log.truncated) == (40, False)


def test_the_summary_is_that_of_the_messages(tmp_path):
    path = record(tmp_path / "run.mcap", map(cycle_at, range(30)), chunk_cycles=1)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary, messages = reader.get_summary(), list(reader.iter_messages(log_time_order=False))
    assert summary is not None
    told = summary.statistics
    assert told is not None
    assert told.channel_message_counts == Counter(message.channel_id for _, _, message in messages)
    assert told.message_count == len(messages)
    times_ns = [message.log_time for _, _, message in messages]
    assert (told.message_start_time, told.message_end_time) == (min(times_ns), max(times_ns))
    assert (told.schema_count, told.channel_count) == (len(summary.schemas), len(summary.channels))
    assert (told.chunk_count, told.metadata_count, len(summary.metadata_indexes)) == (31, 2, 2)


PARAMS = arm_named("nominal").params
READY_RAD = PARAMS.poses.ready_rad
TURN = MoveJoint(Joint.WRIST, READY_RAD[Joint.WRIST] + 0.02)


def test_the_log_holds_every_cycle_and_replays_bit_for_bit(tmp_path):
    loop = start_loop("as-built:7", effects=["coulomb-friction:elbow:torque_Nm=25"], start_rad=READY_RAD)
    result = record_commands(tmp_path / "run.mcap", loop, TURN)
    log = read_log(tmp_path / "run.mcap")
    motor_rad = result.series("outputs.joint.motor_rad")[1]
    np.testing.assert_array_equal(log["/joint"]["motor_rad"], motor_rad)
    assert log.header["arm"] == "as-built:7"
    assert json.loads(log.header["effects"]) == ["coulomb-friction:elbow:torque_Nm=25.0"]
    assert replay(ReplayRequest(tmp_path / "run.mcap")).differences.identical


def test_an_arm_of_the_program_itself_is_recorded_with_all_its_effects(tmp_path):
    arm = BuiltArm("mine", arm_named("as-built:7").effects[:2], PARAMS)
    record_commands(tmp_path / "run.mcap", start_loop(arm, start_rad=READY_RAD), TURN)
    assert len(json.loads(read_log(tmp_path / "run.mcap").header["effects"])) == 2


def test_a_run_that_has_begun_is_not_recorded(tmp_path):
    loop = start_loop(start_rad=READY_RAD)
    loop.cycle()
    with pytest.raises(ValueError, match="tick 1"):
        record_commands(tmp_path / "run.mcap", loop, TURN)
    assert not (tmp_path / "run.mcap").exists()

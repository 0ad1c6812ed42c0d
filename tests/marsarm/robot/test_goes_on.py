"""A diagnosis on the command line that is killed: the same command goes on, and prints the same document."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import pytest

from simgap.command.diagnosis import GOES_ON
from simgap.logs import Logs, Signal
from tests.marsarm.command import ROOT, marsarm_process
from validation.cases.robot import write_logs, write_robot
from validation.cases.robot_draw import draw_case

WORDS = ("robot", "diagnose", "robot.toml", "log.parquet", "--json")
N_SAMPLES = 400
WAIT_s = 300.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a pendulum and four short motions of it."""
    place = tmp_path_factory.mktemp("pendulum")
    robot, logs, _ = draw_case(11, "none", "pendulum")
    motions = []
    for motion in logs.fit[:4]:
        log = motion.joints["swing"]
        cut = {
            one.name: Signal(value.time_s[:N_SAMPLES], value.value[:N_SAMPLES])
            for one in fields(log)
            if (value := getattr(log, one.name)) is not None
        }
        motions.append(replace(motion, joints={"swing": replace(log, **cut)}))
    write_robot(place, robot, frozenset(), tuple(motion.name for motion in motions))
    text = (place / "robot.toml").read_text().replace('split = "split.toml"\n', "")
    (place / "robot.toml").write_text(text)
    write_logs(place / "log.parquet", Logs(tuple(motions)))
    return place


def steps(cache: Path) -> list[Path]:
    return sorted(cache.glob("marsarm/robot-steps/*/*.npz"))


ENDING = """
import os, signal, sys
from simgap.selection.checkpoint import Checkpoint
from marsarm.__main__ import start

number, keep = int(sys.argv.pop(1)), Checkpoint._write

def keep_and_end(*args):
    keep(*args)
    os.kill(os.getpid(), number)

Checkpoint._write = keep_and_end
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background of a shell ignore it
start()
"""


def end_at_step(number: signal.Signals, folder: Path, cache: Path) -> tuple[int, str]:
    """Start a diagnosis that sends itself a signal once it has kept a step; return its status and errors."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-c", ENDING, str(int(number)), *WORDS]
    ended = subprocess.run(command, cwd=folder, env=env, text=True, capture_output=True, timeout=WAIT_s)
    return ended.returncode, ended.stderr


@pytest.mark.slow
def test_a_killed_command_goes_on_and_prints_the_same_document(folder: Path, tmp_path: Path) -> None:
    whole = marsarm_process(folder, *WORDS, XDG_CACHE_HOME=str(tmp_path / "other"))
    assert whole.returncode == 0, whole.stderr
    assert end_at_step(signal.SIGKILL, folder, tmp_path)[0] == -signal.SIGKILL
    (first,) = [(path.name, path.stat().st_mtime_ns) for path in steps(tmp_path)]
    status, errors = end_at_step(signal.SIGINT, folder, tmp_path)
    assert (status, errors.count(GOES_ON)) == (128 + signal.SIGINT, 1)
    kept, _ = [(path.name, path.stat().st_mtime_ns) for path in steps(tmp_path)]
    assert kept == first
    last = marsarm_process(folder, *WORDS, XDG_CACHE_HOME=str(tmp_path))
    assert json.loads(last.stdout) == json.loads(whole.stdout)
    assert last.stdout == whole.stdout
    assert steps(tmp_path) == []

"""An interrupted diagnosis on the command line: the same command goes on, and prints the same document."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from helpers.arm_folder import ROBOT
from helpers.command import run_simgap
from helpers.pendulum import at_swing, motion, pendulum, simulated, waves
from simgap.command.diagnosis import GOES_ON
from simgap.effects.actuation import GainError

SWING = """
[joints.swing]
mode = "position"
kp_Nm_rad = 4.0
kd_Nms_rad = 0.1
command = { column = "command", unit = "rad" }
position = { column = "position", unit = "rad" }
"""
WORDS = ("diagnose", "robot.toml", "log.parquet", "--json")
WAIT_s = 300.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a pendulum and three short motions of it."""
    place = tmp_path_factory.mktemp("pendulum")
    robot, time_s = pendulum(), 0.02 * np.arange(100)
    (place / "model.xml").write_text(robot.model_xml)
    (place / "robot.toml").write_text(ROBOT.replace('tool_site = "tip"\n', "") + SWING)
    columns: dict[str, list[float | str]] = {"t": [], "motion": [], "command": [], "position": []}
    for k in range(3):
        command = waves(time_s, k)
        position = simulated(robot, motion(time_s, command, command), (at_swing(GainError, robot), [0.2]))
        for name, values in zip(columns, (time_s, [f"motion {k}"] * 100, command, position), strict=True):
            columns[name].extend(values)
    pq.write_table(pa.table(columns), place / "log.parquet")
    return place


def steps(cache):
    return sorted(cache.glob("simgap/steps/*/*.npz"))


ENDING = """
import os, signal, sys
from simgap.selection.checkpoint import Checkpoint
from simgap.__main__ import start

keep = Checkpoint._write

def keep_and_end(*args):
    keep(*args)
    os.kill(os.getpid(), signal.SIGINT)

Checkpoint._write = keep_and_end
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background of a shell ignore it
start()
"""


def run(folder, cache, *start):
    """Run a diagnosis to its end, or as a program says."""
    env = os.environ | {"XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, *(start or ("-m", "simgap")), *WORDS]
    return subprocess.run(command, cwd=folder, env=env, text=True, capture_output=True, timeout=WAIT_s)


def test_base_parameters_alone_are_fitted_without_the_catalogue(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    files = ("--report", str(tmp_path / "page.html"), "--patch", str(tmp_path / "found"))
    done = run_simgap(folder, *WORDS, "--terms", "none", *files)
    found = json.loads(done.stdout)
    assert (tmp_path / "found" / "patched.xml").is_file()
    assert '<figure class="traces"' in (tmp_path / "page.html").read_text()
    assert (found["findings"], found["verdict"], steps(tmp_path)) == ([], "unknown", [])
    (error,) = found["errors"]
    assert error["base"] < 0.01 * error["nominal"]
    (gain,) = [one["value"] for one in found["base"] if one["name"] == "gain_ratio"]
    assert gain == pytest.approx(0.2, abs=0.01)


@pytest.mark.slow
def test_an_interrupted_command_goes_on_and_prints_the_same_document(folder, tmp_path):
    whole = run(folder, tmp_path / "other")
    assert whole.returncode == 0, whole.stderr
    ended = run(folder, tmp_path, "-c", ENDING)
    assert (ended.returncode, ended.stderr.count(GOES_ON)) == (128 + signal.SIGINT, 1)
    assert len(steps(tmp_path)) == 1
    last = run(folder, tmp_path)
    assert json.loads(last.stdout) == json.loads(whole.stdout)
    assert last.stdout == whole.stdout
    assert steps(tmp_path) == []

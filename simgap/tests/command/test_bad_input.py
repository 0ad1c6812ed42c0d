"""Wrong input of `simgap`: one sentence, status 2, nothing written, and no simulation before.

The tables hold wrong logs, robot files, splits, effects and options of an arm of two joints.
"""

import os
import shlex
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import simgap.command.diagnosis
import simgap.diagnosis
from helpers.arm_folder import columns_of, write_arm, write_logs
from helpers.command import LIBRARY_WORDS, run_simgap, snapshot
from helpers.effect_lab import own_effect
from helpers.marks import slow_but
from helpers.planar_arm import planar_arm, slow_logs

POSITION = 'column = "position_elbow", unit = "rad"'
ROBOTS = {
    "other_unit.toml": (POSITION, POSITION.replace("rad", "deg")),
    "milliseconds.toml": ('unit = "s"', 'unit = "ms"'),
    "velocity.toml": (f"position = {{ {POSITION}", 'velocity = { column = "speed", unit = "rad/s" }\n{}'),
    "shared_position.toml": ("position_elbow", "position_shoulder"),
    "own_command.toml": ("command_elbow", "position_elbow"),
    "negative.toml": ("kd_Nms_rad = 1.0", "kd_Nms_rad = -1.0"),
    "long_step.toml": ("time_step_s = 0.002", "time_step_s = 1.0"),
    "zero_byte.toml": ("model.xml", "mod\\u0000el.xml"),
    "no_command.toml": ('command = { column = "command_elbow", unit = "rad" }', ""),
    "empty_split.toml": ("time_step_s", 'split = "split.toml"\ntime_step_s'),
}
"""Text of the good robot file, and what replaces its first copy there."""
EFFECTS = {"raises.py": "raise ValueError('no')\n", "exits.py": "raise SystemExit(0)\n"}
EFFECTS["boom.py"] = own_effect(hook="def torque_Nm(self, size, state): return size / 0")
EFFECTS["word.py"] = own_effect('(Size("push_Nm", 0.0, 1.0, "much"),)')


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a good robot and log, and with files that are wrong in one thing each."""
    place = tmp_path_factory.mktemp("bad")
    write_arm(place)
    write_wrong_logs(place)
    robot = (place / "robot.toml").read_text()
    for name, (before, after) in ROBOTS.items():
        assert before in robot
        (place / name).write_text(robot.replace(before, after.replace("{}", before), 1))
    (place / "split.toml").write_text("")
    (place / "cut.npz").write_text("PK\x03\x04xx")
    for name in ("pipe.toml", "pipe.parquet", "pipe.py"):
        os.mkfifo(place / name)
    for name, text in EFFECTS.items():
        (place / name).write_text(text)
    (place / "held" / "runtime.toml").mkdir(parents=True)
    (place / "linked").mkdir()
    (place / "linked" / "effects.toml").symlink_to("nosuch")
    (place / "patched.toml").write_text(robot.replace("model.xml", "patched.xml"))
    (place / "patched.xml").write_text((place / "model.xml").read_text())
    return place


def write_wrong_logs(place):
    """Write tables with one wrong column each, and files that are no tables."""
    logs = slow_logs(planar_arm())
    columns = columns_of(logs)
    position, command, time_s = (columns[one] for one in ("position_elbow", "command_elbow", "t"))
    speed = np.gradient(position, 0.02)
    write_logs(place / "log.parquet", logs)

    def write(name, **changes):
        write_logs(place / f"{name}.parquet", logs, **changes)

    for factor, name in ((180 / np.pi, "57"), (1000.0, "1000")):
        for word, wrong in ((name, factor), (f"1_{name}", 1 / factor)):
            write(f"position_{word}", position_elbow=wrong * position)
            write(f"command_{word}", command_elbow=wrong * command)
            write(f"velocity_{word}", speed=wrong * speed)
        write(f"angles_{name}", position_elbow=factor * position, command_elbow=factor * command)
    write("time_1000", t=1000.0 * time_s)
    write("time_1_1000", t=time_s / 1000.0)
    write("gap", t=np.append(time_s[:599], [1e6, *time_s[600:]]))
    write("huge", position_elbow=np.append(position[:10], [1e300, *position[11:]]))
    write("still_elbow", position_elbow=np.full(position.size, 0.4))
    of_motion = [columns["motion"] == one.name for one in logs.motions]
    shuffled = {
        name: np.concatenate([columns[name][rows] for rows in (*of_motion[1:], of_motion[0])])
        for name in ("command_shoulder", "command_elbow")
    }
    write("shuffled", **shuffled)
    copied = {
        name: np.concatenate([values[of_motion[0]], values[600:1800], values[of_motion[0]]])
        for name, values in columns.items()
        if name not in ("t", "motion")
    }
    write("copied", **copied)
    table = pq.read_table(place / "log.parquet")
    pq.write_table(table.slice(0, 1), place / "one_row.parquet")
    names = [*table.column_names, "position_elbow"]
    pq.write_table(pa.Table.from_arrays([*table.columns, table["t"]], names), place / "twice.parquet")


BOTH = {
    # columns and values
    "robot.toml twice.parquet": "has 2 columns 'position_elbow'; give each its own name",
    "robot.toml huge.parquet": "reaches 1e+300 in SI units",
    "robot.toml one_row.parquet": "motion 'motion 0' has 1 position; a motion needs several",
    # time
    "robot.toml gap.parquet": "with 1 gap of up to",
    "robot.toml time_1000.parquet": "the times look 1000 times too long; write time.unit = 'ms'",
    "robot.toml time_1_1000.parquet": "the times look 1000 times too short",
    "milliseconds.toml log.parquet": "the times look 1000 times too short; write time.unit = 's'",
    # files
    "robot.toml pipe.parquet": "is no regular file; name a log",
    "robot.toml cut.npz": "is no NumPy .npz file",
    "pipe.toml log.parquet": "is not a regular file",
    "zero_byte.toml log.parquet": "is no name of a file; give the path of an MJCF file",
    # robot
    "shared_position.toml log.parquet": "elbow.position.column: is that of joints.shoulder.position too",
    "own_command.toml log.parquet": "joints.elbow.command.column: is that of joints.elbow.position too",
    "negative.toml log.parquet": "kd_Nms_rad: should be greater than or equal to 0, not -1.0",
    "long_step.toml log.parquet": "time_step_s: should be less than or equal to 0.1, not 1.0",
    # split
    "empty_split.toml log.parquet": "default: is missing",
}
"""Part of the sentence, by arguments of both verbs."""
CHECK = {
    "robot.toml": "logs: none is given; name at least one log file",
    "held log.parquet": "; or name a robot file, which ends in .toml",
}
"""Part of the sentence, by arguments of `check`."""
UNITS = {
    f"{robot}.toml {name}_{factor}.parquet": word
    for robot, name, word in (
        ("robot", "position", "times its command"),
        ("robot", "command", "times its command"),
        ("velocity", "velocity", "times the change of the position"),
    )
    for factor in ("57", "1_57", "1000", "1_1000")
}
DIAGNOSE = {
    **UNITS,
    "robot.toml angles_57.parquet": "is the log in degrees?",
    "robot.toml angles_1000.parquet": "is the log in thousandths?",
    "other_unit.toml log.parquet": "times its command",
    "robot.toml shuffled.parquet": "follow the command of another motion better than their own",
    "robot.toml shuffled.parquet --held-out 'motion 3'": "follow the command of another motion",
    "robot.toml copied.parquet --held-out 'motion 3'": "motion 3 is held out and is fitted as motion 0",
    "no_command.toml log.parquet": "joint elbow has no command",
    # options
    "robot.toml --seed 1": "Missing argument 'LOG...'",
    "robot.toml log.parquet --nosuch": "No such option",
    "robot.toml log.parquet --nested": "nested: is for poses of a tracker",
    "robot.toml log.parquet --seed -1": "seed: -1 is below 0",
    "robot.toml log.parquet --split nosuch": "the robot file names no split file",
    "robot.toml log.parquet --held-out 'motion 2,motion 3'": "name each by itself: --held-out A",
    "robot.toml log.parquet --held-out ''": "'' is no motion, condition or file",
    "robot.toml log.parquet --split a --held-out log": "they exclude each other",
    "robot.toml log.parquet --report check.txt": "its name must end in .html",
    "robot.toml log.parquet --report nosuch/a.html": "there is no folder nosuch",
    "robot.toml log.parquet --patch nosuch/a": "there is no folder nosuch",
    "robot.toml log.parquet --patch log.parquet": "this is a file; give the path of a folder",
    "robot.toml log.parquet --patch held": "held/runtime.toml: this is a folder; give another folder",
    "robot.toml log.parquet --patch linked": "effects.toml: this is a link to nosuch, which is not there",
    "patched.toml log.parquet --patch .": "this is the file of model too",
    "robot.toml still_elbow.parquet": "constant; the position stays at 0.4 rad, while the command spans",
    "robot.toml log.parquet --patch a.html --report a.html": "this is the file of report too",
    # effects
    "robot.toml log.parquet --effects pipe.py": "no such file",
    "robot.toml log.parquet --effects raises.py": "cannot be run: ValueError: no",
    "robot.toml log.parquet --effects exits.py": "cannot be run: SystemExit: 0",
    "robot.toml log.parquet --effects word.py": "low, high and typical have to be numbers",
    "robot.toml log.parquet --effects boom.py --effects boom.py": "two have the key 'shoulder: mine'",
}
"""Part of the sentence, by arguments of `diagnose`."""


@pytest.fixture
def no_simulation(monkeypatch):
    """Let no verb simulate the motions: a refusal comes first."""

    def refuse(*_, **__):
        raise AssertionError

    monkeypatch.setattr(simgap.diagnosis, "select_effects", refuse)
    monkeypatch.setattr("simgap.command.check.simulate_nominal", refuse)


@pytest.mark.usefixtures("no_simulation")
@pytest.mark.parametrize(
    ("verb", "words"),
    [
        *(("check", one) for one in (*BOTH, *CHECK)),
        *slow_but((("diagnose", one) for one in BOTH), ("diagnose", next(iter(BOTH)))),
        *slow_but((("diagnose", one) for one in UNITS), *(("diagnose", one) for one in list(UNITS)[::5])),
        *(("diagnose", one) for one in DIAGNOSE if one not in UNITS),
    ],
)
def test_wrong_input_gets_one_sentence_and_leaves_nothing(folder, verb, words):
    before = snapshot(folder)
    done = run_simgap(folder, verb, *shlex.split(words))
    assert {**BOTH, **CHECK, **DIAGNOSE}[words] in done.stderr
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert not LIBRARY_WORDS.search(done.stderr)
    assert snapshot(folder) == before


def test_an_effect_that_raises_in_a_simulation_is_named_with_its_line(folder, monkeypatch):
    def simulate(*_, effects, **__):
        effects[0].torque_Nm(1.0, SimpleNamespace())

    monkeypatch.setattr(simgap.command.diagnosis, "diagnose", simulate)
    before = snapshot(folder)
    done = run_simgap(folder, "diagnose", "robot.toml", "log.parquet", "--effects", "boom.py")
    assert done.returncode == 2
    assert "boom.py:14: ZeroDivisionError" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert snapshot(folder) == before


def test_a_simulation_that_becomes_unstable_leaves_no_file_of_mujoco(folder):
    before = snapshot(folder)
    assert "blew up" in run_simgap(folder, "check", "robot.toml", "angles_1000.parquet").stdout
    assert snapshot(folder) == before

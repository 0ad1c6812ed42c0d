"""Models of real robots, and the logs that were measured on them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simgap.loading import load
from simgap.robot import Robot

ROBOTS = ("so101", "kr300", "pendulum", "ur10")
LOADED = {
    "so101": {"shoulder_lift", "elbow_flex", "wrist_flex"},
    "kr300": {"a2", "a3", "a4", "a5"},
    "pendulum": {"servo"},
}
"""Joints that gravity moves against their friction."""
LOGS = {
    "so101": ("so101/so101.parquet",),
    "kr300": ("kr300/kr300_A.parquet", "kr300/kr300_B.parquet"),
    "pendulum": ("xl330/xl330.parquet",),
}


def repository_file(path):
    """Return the path of a file of the repository; skip the test where `simgap/` stands alone."""
    found = Path(__file__).parents[3] / path
    if not found.exists():
        pytest.skip(f"{path} is in the repository, not here", allow_module_level=True)
    return found


def robot_path(name):
    """Return the path of a robot file."""
    return repository_file(f"models/robots/{name}/robot.toml")


def load_real(folder, name):
    """Return a robot with all its measured logs."""
    robot = Robot.from_toml(robot_path(name))
    return robot, load(robot, [folder / one for one in LOGS[name]])


def exchange_commands(motions, seed):
    """Give each motion the commands of another one: a cycle through all motions in random order."""
    order = np.random.default_rng(seed).permutation(len(motions))
    other = dict(zip(order.tolist(), np.roll(order, 1).tolist(), strict=True))
    exchanged = []
    for k, motion in enumerate(motions):
        sent = {name: log.command for name, log in motions[other[k]].joints.items()}
        joints = {name: replace(log, command=sent[name]) for name, log in motion.joints.items()}
        exchanged.append(replace(motion, joints=joints))
    return tuple(exchanged)

"""Published logs of the SO-101 become the columns that its robot file reads."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from helpers.real_robots import robot_path
from simgap.common.errors import RobotError
from simgap.loading import load, read_split
from simgap.robot import Robot
from validation.so101 import convert

JOINTS = tuple(one.name for one in Robot.from_toml(robot_path("so101")).joints)
PARTS = read_split(robot_path("so101").parent / "split.toml").parts
MOTIONS = [one for part in PARTS.values() for one in part]
ROWS = 4


def write_motion(folder, first, states=ROWS):
    """Write a motion as upstream does: positions count up from joint to joint and from row to row."""

    def cells(row, shift):
        return str([first + shift + 0.01 * row + 0.001 * j for j in range(len(JOINTS))])

    folder.mkdir()
    control = [f'CONTROL,{20000.0 * k},"{cells(k, 0.0)}"' for k in range(ROWS)]
    state = [f'STATE_MOTOR,{20000.0 * k},"{cells(k, 0.1)}","{cells(k, 0.2)}","[]"' for k in range(states)]
    for name, head, rows in (
        ("control", "type,timestamp,positions", control),
        ("state_motor", "type,timestamp,positions,velocities,torques", state),
    ):
        (folder / f"{name}.csv").write_text("\n".join((head, *rows)) + "\n")


def test_all_motions_are_converted_and_those_of_the_split_are_loaded(tmp_path):
    for k, name in enumerate((*MOTIONS, "newer_motion")):
        write_motion(tmp_path / name, 0.1 * k)
    pq.write_table(convert(tmp_path, JOINTS), tmp_path / "so101.parquet")
    logs = load(robot_path("so101"), [tmp_path / "so101.parquet"])
    motions = logs.motions
    assert sorted(one.name for one in motions) == sorted(MOTIONS)
    assert logs.losses == ("1 motion is left out, because no part of the split 'fit_a' has it: newer_motion",)
    chirp = next(one for one in motions if one.name == "chirp_sweep")
    elbow, first = chirp.joints["elbow_flex"], 0.1 * MOTIONS.index("chirp_sweep")
    np.testing.assert_allclose(elbow.position.time_s, [0.0, 0.02, 0.04, 0.06])
    np.testing.assert_allclose(elbow.command.value, first + 0.002 + 0.01 * np.arange(ROWS))
    np.testing.assert_allclose(elbow.position.value, first + 0.102 + 0.01 * np.arange(ROWS))
    np.testing.assert_allclose(elbow.velocity.value, first + 0.202 + 0.01 * np.arange(ROWS))


def test_a_folder_that_is_not_that_of_the_motions_is_refused_by_name(tmp_path):
    with pytest.raises(RobotError, match="has no folder of a motion"):
        convert(tmp_path, JOINTS)
    write_motion(tmp_path / "step_response", 0.0, states=ROWS - 1)
    with pytest.raises(RobotError, match="has 4 commands and 3 states"):
        convert(tmp_path, JOINTS)
    (tmp_path / "step_response" / "control.csv").unlink()
    with pytest.raises(RobotError, match=r"step_response/control.csv: is no log of the SO-101"):
        convert(tmp_path, JOINTS)

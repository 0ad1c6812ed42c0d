"""Currents stand for torques: without gains, and with a torque constant that is known or fitted."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.robot_folder import write_csv, write_robot
from helpers.two_joint_arm import arm, simulated
from simgap import diagnose
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.command.check import simulate_nominal
from simgap.common.errors import RobotError
from simgap.effects.actuation import CurrentScale
from simgap.loading import load, take_currents_as_torques
from simgap.logs import Logs, Signal
from simgap.patch.patch import make_patch
from simgap.residuals.simulation_residuals import list_kinds
from simgap.robot import Robot
from simgap.simulation.compiled import Models

ELBOW = 'torque = { column = "m2", unit = "mN m", side = "motor" }'
CURRENT = 'current = { column = "m2", unit = "mA" }\ntorque_constant_Nm_A = 2.5'


@cache
def motion(seed):
    return simulated(arm(), seed, noise_rad=1e-5, name=f"m{seed}")


def guessed(constant_Nm_A, true_Nm_A, is_known, count):
    """Return the arm and its logs, in which torques are known as currents."""
    robot = arm()
    guess = {"torque_constant_Nm_A": constant_Nm_A, "torque_constant_is_known": is_known}
    robot = replace(robot, joints=tuple(replace(one, **guess) for one in robot.joints))
    motions = []
    for one in map(motion, range(count)):
        joints = {
            name: replace(log, torque=None, current=Signal(log.torque.time_s, log.torque.value / true_Nm_A))
            for name, log in one.joints.items()
        }
        motions.append(take_currents_as_torques(robot, replace(one, joints=joints)))
    return robot, motions


def test_a_current_with_its_constant_is_read_as_a_torque(tmp_path):
    path = write_robot(tmp_path, (ELBOW, CURRENT))
    log = load(path, write_csv(tmp_path)).motions[0].joints["elbow"]
    assert np.array_equal(log.torque.value, 2.5 * log.current.value)
    without = load(write_robot(tmp_path, (ELBOW, CURRENT.split("\n")[0])), tmp_path / "log.csv")
    assert without.motions[0].joints["elbow"].torque is None


def test_no_gain_is_asked_where_torques_are_compared(tmp_path):
    gains = ('gain_column = "gain"\nkp_Nm_rad = 15.0\n', "")
    shoulder = ("[joints.elbow]", 'torque = { column = "m2", unit = "N m" }\n\n[joints.elbow]')
    path = write_robot(tmp_path, gains, shoulder, (ELBOW, ""))
    text = (tmp_path / "model.xml").read_text()
    model = text.replace('kp="30" kv="2" ', "").replace("<position ", "<motor ")
    (tmp_path / "model.xml").write_text(model)
    robot = Robot.from_toml(path)
    assert math.isnan(robot.joint("shoulder").kp_Nm_rad)
    logs = load(robot, write_csv(tmp_path))
    assert [one.name for one in list_kinds(robot, logs.motions, None)] == ["inverse dynamics"]
    assert math.isnan(simulate_nominal(Models(robot), logs.motions[0]).mean_abs_rad["shoulder"])
    assert '<motor name="shoulder"' in make_patch(robot, [], []).model_xml  # it keeps what it has
    path.write_text(path.read_text().replace('torque = { column = "m2", unit = "N m" }\n', ""))
    with pytest.raises(RobotError, match=r"joints.shoulder.kp_Nm_rad: is 0 or missing"):
        Robot.from_toml(path)


@pytest.mark.parametrize("more", ["", 'current = { column = "m2", unit = "mA" }\n'])
def test_a_guess_without_a_current_in_place_of_a_torque_or_without_a_number_is_refused(tmp_path, more):
    guess = "torque_constant_is_known = false"
    with pytest.raises(RobotError, match="torque_constant_is_known: counts where a current stands for"):
        Robot.from_toml(write_robot(tmp_path, (ELBOW, f"{ELBOW}\n{more}{guess}")))
    text = CURRENT.split("\n")[0] + f"\n{guess}"
    with pytest.raises(RobotError, match=r"torque_constant_Nm_A: is missing; with torque_constant_is_known"):
        Robot.from_toml(write_robot(tmp_path, (ELBOW, text)))


def test_the_scale_of_a_current_is_a_base_parameter_only_if_it_is_a_guess():
    for is_known in (True, False):
        robot, motions = guessed(10.0, 10.0, is_known, 1)
        logs = Logs(tuple(motions))
        found = [one for one in base_effects(robot, logs) if isinstance(one, CurrentScale)]
        assert [one.place for one in found] == ([] if is_known else ["shoulder", "elbow"])
        assert not any(isinstance(one, CurrentScale) for one in catalogue(robot, logs))


@pytest.mark.slow
def test_a_wrong_scale_of_a_current_is_found():
    robot, motions = guessed(10.0, 10.8, False, 6)
    result = diagnose(robot, motions)
    scale = {one.place: one for one in result.base if one.name == "torque_constant_Nm_A"}
    for place in ("shoulder", "elbow"):
        assert scale[place].nominal == 10.0
        assert scale[place].value == pytest.approx(10.8, rel=0.02)
    assert result.findings == ()

"""Settings of a user's actuators: the patched model simulates what the engine simulates."""

import mujoco
import numpy as np
import pytest

from helpers import pendulum
from simgap.common.errors import RobotError
from simgap.patch.patch import make_patch
from simgap.patch.runtime import RuntimeEffects, RuntimeJoint
from test_patch import COMMAND, TIME_s, by_engine


def read(folder, actuator, mode="position", of_joint="", more=""):
    """Read the pendulum with an actuator of its own."""
    xml = pendulum.pendulum().model_xml.replace("</mujoco>", f"<actuator>{actuator}</actuator></mujoco>")
    return pendulum.read(folder, xml.replace('name="swing"', f'name="swing" {of_joint}'), mode, more=more)


def by_patch(robot):
    """Return what the encoder shows with the patched model, (n,)."""
    model = mujoco.MjModel.from_xml_string(make_patch(robot, [], []).model_xml)
    joint, data = robot.joints[0], mujoco.MjData(model)
    runtime = RuntimeEffects(model, [], [RuntimeJoint("swing", "swing", "swing", joint.mode)], 0.002)
    shown = [0.0]
    for k in range(5 * (TIME_s.size - 1)):
        runtime.act(model, data, COMMAND[[k // 5]])
        mujoco.mj_step(model, data, runtime.n_steps)
        if k % 5 == 4:
            shown.append(runtime.shown(data)[0])
    return shown


@pytest.mark.parametrize(
    ("actuator", "mode"),
    [
        ('<position joint="swing" gear="-1" kp="4" kv="0.1" forcerange="-1 1"/>', "position"),
        ('<position joint="swing" gear="-2" kp="1" kv="0.03" forcerange="-0.2 0.2"/>', "position"),
        ('<motor joint="swing" gear="-3" forcerange="-0.1 0.1"/>', "torque"),
    ],
)
def test_a_gear_that_turns_the_other_way_keeps_its_sign(actuator, mode, tmp_path):
    robot = read(tmp_path, actuator, mode)
    engine = by_engine([], [], robot)
    assert np.ptp(engine) > 0.3
    assert by_patch(robot) == pytest.approx(engine, abs=1e-9)


def test_a_range_of_commands_limits_neither_the_engine_nor_the_patch(tmp_path):
    robot = read(tmp_path, '<position joint="swing" ctrlrange="-0.1 0.1" kp="4" kv="0.1"/>')
    engine = by_engine([], [], robot)
    assert np.ptp(engine) > 0.3
    assert by_patch(robot) == pytest.approx(engine, abs=1e-9)


def test_an_actuator_with_dynamics_of_its_own_is_refused(tmp_path):
    with pytest.raises(RobotError, match="has dynamics of its own"):
        read(tmp_path, '<position joint="swing" kp="4" kv="0.1" timeconst="0.05"/>')


@pytest.mark.parametrize("given_Nm", [None, 1.0])
def test_the_torque_limit_is_the_smaller_range_or_that_of_the_file(given_Nm, tmp_path):
    actuator = '<position joint="swing" kp="4" kv="0.1" gear="-2" forcerange="-1 1"/>'
    more = f"torque_limit_Nm = {given_Nm}" if given_Nm else ""
    robot = read(tmp_path, actuator, of_joint='actuatorfrcrange="-0.3 0.3"', more=more)
    assert robot.joints[0].torque_limit_Nm == (given_Nm or 0.3)
    assert by_patch(robot) == pytest.approx(by_engine([], [], robot), abs=1e-9)


@pytest.mark.parametrize(
    ("of_joint", "range_", "said"),
    [
        ("", "0 2", "forcerange of the model is 0 to 4 N m at the joint; give one limit"),
        ('actuatorfrcrange="-1 3"', "-1 1", "actuatorfrcrange of the model is -1 to 3 N m"),
    ],
)
def test_a_limit_that_differs_by_direction_is_refused(of_joint, range_, said, tmp_path):
    actuator = f'<position joint="swing" kp="4" gear="2" forcerange="{range_}"/>'
    with pytest.raises(RobotError, match=f"joints.swing.torque_limit_Nm: {said}"):
        read(tmp_path, actuator, of_joint=of_joint)

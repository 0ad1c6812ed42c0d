"""Settings of a user's actuators: the patched model simulates what the engine simulates."""

import mujoco
import numpy as np
import pytest

from diagnosis.patch import make_patch
from diagnosis.robot import Robot
from diagnosis.runtime import RuntimeEffects, RuntimeJoint
from tests.diagnosis.pendulum import pendulum
from tests.diagnosis.test_patch import COMMAND, TIME_s, by_engine

FILE = """name = "pendulum"
model = "model.xml"
time_step_s = 0.002
control_rate_Hz = 500.0
[time]
column = "t"
unit = "s"
[joints.swing]
mode = "{mode}"
position = {{ column = "q", unit = "rad" }}
command = {{ column = "c", unit = "{unit}" }}
"""
UNITS = {"position": "rad", "torque": "N m"}


def read(folder, actuator, mode="position", of_joint=""):
    """Read the pendulum with an actuator of its own."""
    xml = pendulum().model_xml.replace("</mujoco>", f"<actuator>{actuator}</actuator></mujoco>")
    (folder / "model.xml").write_text(xml.replace('name="swing"', f'name="swing" {of_joint}'))
    (folder / "robot.toml").write_text(FILE.format(mode=mode, unit=UNITS[mode]))
    return Robot.from_toml(folder / "robot.toml")


def by_patch(robot):
    """Return what the encoder shows with the patched model, (n,)."""
    model = mujoco.MjModel.from_xml_string(make_patch(robot, [], []).model_xml)
    joint, data = robot.joints[0], mujoco.MjData(model)
    runtime = RuntimeEffects(model, [], [RuntimeJoint("swing", "swing", "swing", joint.mode)], 0.002)
    shown = [0.0]
    for k in range(5 * (TIME_s.size - 1)):
        runtime.step(model, data, COMMAND[[k // 5]])
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

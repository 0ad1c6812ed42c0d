"""DC motors of MuJoCo as nominal drives: the engine moves the joint as MuJoCo does."""

import mujoco
import numpy as np
import pytest

from helpers import pendulum
from helpers.pendulum import motion, simulated, waves
from simgap.common.errors import RobotError
from simgap.patch.patch import make_patch
from simgap.robot import ControlMode

MOTOR = 'motorconst="0.05" resistance="2" gear="20"'
SERVO = '<default><default class="servo"><dcmotor motorconst="0.05" resistance="2"/></default></default>'
STEP_S = 0.0005


def read(folder, attributes, mode, more="", actuator="dcmotor", defaults=""):
    """Read the pendulum with a DC motor."""
    xml = pendulum.pendulum(damping=0.01).model_xml.replace("<worldbody>", f"{defaults}<worldbody>")
    drive = f'<actuator><{actuator} name="motor" joint="swing" {attributes}/></actuator></mujoco>'
    return pendulum.read(folder, xml.replace("</mujoco>", drive), mode, STEP_S, more)


def by_mujoco(text, command, scale=1.0):
    """Return the positions of a model at 1 kHz under a command, (n,)."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
    model.dof_solref[:] = (2 * STEP_S, 1.0)
    data = mujoco.MjData(model)
    shown = []
    for one in command:
        shown.append(data.qpos[0])
        data.ctrl[:] = scale * one
        mujoco.mj_step(model, data)
    return np.array(shown)


@pytest.mark.parametrize(
    ("attributes", "mode", "scale", "expected"),
    [
        (MOTOR, "voltage", 1.0, (0.5, 0.5)),
        ('class="servo" gear="20"', "voltage", 1.0, (0.5, 0.5)),
        (f'{MOTOR} saturation="0.02"', "voltage", 1.0, (0.5, 0.5)),
        (f'{MOTOR} armature="1e-5" damping="1e-5"', "voltage", 1.0, (0.5, 0.5)),
        (f'{MOTOR} input="pos" controller="0.01 0 0.0003"', "position", 20.0, (4.0, 0.12)),
    ],
)
def test_the_engine_moves_as_the_motor_of_mujoco(attributes, mode, scale, expected, tmp_path):
    robot = read(tmp_path, attributes, mode, defaults=SERVO)
    joint = robot.joints[0]
    assert (joint.kp_Nm_rad, joint.kd_Nms_rad) == pytest.approx(expected)
    time_s = STEP_S * np.arange(4000)
    command = waves(time_s, 3)
    engine = simulated(robot, motion(time_s, 0.0 * time_s, command))
    native = by_mujoco(robot.model_xml, command, scale)
    assert np.ptp(native) > 0.2
    assert engine == pytest.approx(native, abs=2e-3)  # half a step of the command, and of the damping
    patched = by_mujoco(make_patch(robot, [], []).model_xml, command, scale)
    assert patched == pytest.approx(native, abs=2e-3)


def test_the_constants_of_a_motor_are_those_at_the_joint(tmp_path):
    joint = read(tmp_path, f'{MOTOR} saturation="0.1"', "current").joints[0]
    assert joint.mode is ControlMode.CURRENT
    assert joint.torque_constant_Nm_A == pytest.approx(1.0)
    assert joint.torque_limit_Nm == pytest.approx(2.0)
    joint = read(tmp_path, MOTOR, "position", "kp_Nm_rad = 3.0").joints[0]
    assert (joint.kp_Nm_rad, joint.kd_Nms_rad) == pytest.approx((3.0, 0.5))


@pytest.mark.parametrize(
    ("said", "given"),
    [
        (r"actuator: 'motor' has dynamics of its own", (f'{MOTOR} inductance="0.001"', "voltage")),
        (r"dynamics of its own \(thermal\); a diagnosis lacks them", (f'{MOTOR} thermal="1 1 1"', "voltage")),
        (r"dynamics of its own \(lugre\)", (f'{MOTOR} lugre="100 1 .1 .2 .01"', "voltage")),
        (r"dynamics of its own \(cogging\)", (f'{MOTOR} cogging="0.01 6 0"', "voltage")),
        ("an integral gain or slewmax", (f'{MOTOR} input="pos" controller="1 1 0"', "position")),
        ("an integral gain or slewmax", (f'{MOTOR} input="pos" controller="1 0 0 5"', "position")),
        ("a largest voltage .* saturation", (f'{MOTOR} input="pos" controller="1 0 0 0 0 12"', "position")),
        ("so set kp to 0", (f'{MOTOR} input="vel" controller="1 0 1"', "velocity")),
        ("joints.swing.kp_Nm_rad: is 0 or missing, and the model has no gain", (MOTOR, "position")),
        ("joints.swing.kd_Nms_rad: is 0 or missing, and the model has no gain", (MOTOR, "velocity")),
        ("kp_Nm_rad: has no meaning in the mode voltage; remove it", (MOTOR, "voltage", "kp_Nm_rad = 3.0")),
        ("mode: is voltage, and the model has no <dcmotor> at", ('gear="2"', "voltage", "", "motor")),
        (
            "'motor' has a delay of its own; a diagnosis looks for delays",
            ('kp="4" delay="0.01" nsample="5"', "position", "", "position"),
        ),
        ("has dynamics of its own", ('kp="4" kv="0.1" timeconst="0.05"', "position", "", "position")),
    ],
)
def test_a_drive_that_no_diagnosis_has_is_refused_in_words(said, given, tmp_path):
    with pytest.raises(RobotError, match=said):
        read(tmp_path, *given)

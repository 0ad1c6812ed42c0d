"""Control laws as attributes of an actuator in MJCF."""

from math import inf

import mujoco

from simgap.patch.patch_text import number_text
from simgap.robot import ControlMode, Robot, RobotJoint


def law_attributes(
    robot: Robot, joint: RobotJoint, kp: float, kd: float, limit: float
) -> tuple[tuple[str, str], ...]:
    """Return the attributes of an actuator with a law; its gear scales length and force."""
    gear = 1.0
    if joint.actuator_index >= 0:
        gear = float(robot.model.actuator_gear[joint.actuator_index, 0])
    position, velocity, gain = {
        ControlMode.POSITION: (kp / gear**2, kd / gear**2, kp / gear**2),
        ControlMode.VELOCITY: (0.0, kd / gear**2, kd / gear**2),
    }.get(joint.mode, (0.0, 0.0, kp / gear))
    return _attributes(gain, position, velocity, limit / abs(gear))


def _attributes(gain: float, position: float, velocity: float, limit: float) -> tuple[tuple[str, str], ...]:
    """Return the attributes; numbers are in the units of the actuator."""
    is_limited = limit < inf
    force = (("forcerange", number_text(-limit, limit)),) if is_limited else ()
    return (
        ("dyntype", "none"),
        ("gaintype", "fixed"),
        ("biastype", "affine"),
        ("gainprm", number_text(gain)),
        ("biasprm", number_text(0.0, -position, -velocity)),
        ("ctrllimited", "false"),  # as in the engine: logged commands are what the robot took
        ("forcelimited", str(is_limited).lower()),
        *force,
    )


def model_law(model: mujoco.MjModel, number: int) -> tuple[tuple[str, str], ...] | None:
    """Return the attributes of an actuator as the model has it; None if it has no such law."""
    if number < 0 or model.actuator_dyntype[number] != mujoco.mjtDyn.mjDYN_NONE:
        return None
    bias = model.actuator_biasprm[number]
    low, high = model.actuator_forcerange[number] if model.actuator_forcelimited[number] else (-inf, inf)
    is_fixed = model.actuator_gaintype[number] == mujoco.mjtGain.mjGAIN_FIXED
    if model.actuator_ctrllimited[number] or not is_fixed or bias[0] != 0.0 or low != -high:
        return None
    return _attributes(float(model.actuator_gainprm[number, 0]), -bias[1], -bias[2], high)

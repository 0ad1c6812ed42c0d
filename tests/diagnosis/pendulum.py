"""A pendulum with a servo, as a robot made by hand."""

from collections.abc import Mapping

import mujoco
import numpy as np

from diagnosis.arrays import Array
from diagnosis.logs import JointLog, Motion, Signal
from diagnosis.robot import ControlMode, Robot, RobotJoint

MASS_kg, LENGTH_m, ARMATURE_kgm2, g_m_s2 = 0.5, 0.1, 0.002, 9.81
XML = """
<mujoco>
  <option timestep="{step}"/>
  <worldbody>
    <body>
      <joint name="{name}" axis="0 1 0" damping="{damping}" frictionloss="{dry}" armature="{armature}"/>
      <inertial pos="0 0 -{length}" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>
    </body>
  </worldbody>
</mujoco>
"""
INERTIA_kgm2 = MASS_kg * LENGTH_m**2 + ARMATURE_kgm2


def pendulum(
    mode: ControlMode = ControlMode.POSITION,
    kp: float = 4.0,
    kd: float = 0.1,
    limit_Nm: float = float("inf"),
    damping: float = 0.02,
    dry_Nm: float = 0.01,
    step_s: float = 0.002,
    period_s: float = 0.002,
) -> Robot:
    """Make a pendulum that hangs down at 0."""
    xml = XML.format(
        step=step_s, name="swing", damping=damping, dry=dry_Nm, armature=ARMATURE_kgm2,
        length=LENGTH_m, mass=MASS_kg,
    )  # fmt: skip
    joint = RobotJoint(
        name="swing", qpos_index=0, dof_index=0, actuator_index=-1, mode=mode, kp_Nm_rad=kp, kd_Nms_rad=kd,
        torque_limit_Nm=limit_Nm, gear_ratio=1.0, torque_constant_Nm_A=2.0, is_known=False,
        is_loaded_by_gravity=True,
    )  # fmt: skip
    return Robot(
        name="pendulum", model=mujoco.MjModel.from_xml_string(xml), model_xml=xml, joints=(joint,),
        control_period_s=period_s, tool_site="",
    )  # fmt: skip


def motion(
    time_s: Array,
    position_rad: Array,
    command: Array,
    name: str = "m",
    joint: str = "swing",
    gain: Mapping[str, float] | None = None,
    **others: Signal,
) -> Motion:
    """Make a log of one joint, all signals at the same times."""
    log = JointLog(position=Signal(time_s, position_rad), command=Signal(time_s, command), **others)
    return Motion(name=name, joints={joint: log}, gain=gain or {})


def waves(time_s: Array, seed: int) -> Array:
    """Make a command of three sines, which starts at 0 with speed 0."""
    rng = np.random.default_rng(seed)
    speeds = rng.uniform(1.0, 6.0, 3)
    return np.asarray(0.3 * np.sum(1 - np.cos(np.outer(time_s, speeds)), axis=1))

"""A pendulum with a servo, as a robot made by hand."""

from dataclasses import replace

import mujoco
import numpy as np

from helpers.robot_folder import write_robot
from simgap.effects.effect import JointScales
from simgap.logs import JointLog, Motion, Signal
from simgap.robot import ControlMode, Robot, RobotJoint
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import cut_windows

MASS_kg, LENGTH_m, ARMATURE_kgm2, g_m_s2 = 0.5, 0.1, 0.002, 9.81
XML = """
<mujoco>
  <option timestep="{step}"/>
  <worldbody>
    <body>
      <joint name="{name}" axis="{axis}" damping="{damping}" frictionloss="{dry}" armature="{armature}"/>
      <inertial pos="{arm}" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>
    </body>
  </worldbody>
</mujoco>
"""
FILE = """name = "pendulum"
model = "model.xml"
time_step_s = {step_s}
control_rate_Hz = {rate_Hz}
time = {{ column = "t", unit = "s" }}
[joints.swing]
mode = "{mode}"
position = {{ column = "q", unit = "rad" }}
command = {{ column = "c", unit = "{unit}" }}
{more}
"""
UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m", "current": "A", "voltage": "V"}
INERTIA_kgm2 = MASS_kg * LENGTH_m**2 + ARMATURE_kgm2


def pendulum(
    mode=ControlMode.POSITION,
    kp=4.0,
    kd=0.1,
    limit_Nm=float("inf"),
    damping=0.02,
    dry_Nm=0.01,
    step_s=0.002,
    period_s=0.002,
    is_level=False,
):
    """Make a pendulum that hangs down at 0, or one that swings in a level plane."""
    arm = f"{LENGTH_m} 0 0" if is_level else f"0 0 -{LENGTH_m}"
    xml = XML.format(
        step=step_s, name="swing", damping=damping, dry=dry_Nm, armature=ARMATURE_kgm2,
        axis="0 0 1" if is_level else "0 1 0", arm=arm, mass=MASS_kg,
    )  # fmt: skip
    joint = RobotJoint("swing", 0, 0, mode, kp, kd, limit_Nm, torque_constant_Nm_A=2.0)
    return Robot("pendulum", mujoco.MjModel.from_xml_string(xml), xml, (joint,), period_s, "")


def read(folder, xml, mode, step_s=0.002, more=""):
    """Read a pendulum of this model from the files of a user."""
    text = FILE.format(mode=mode, unit=UNITS[mode], step_s=step_s, rate_Hz=round(1 / step_s), more=more)
    return Robot.from_toml(write_robot(folder, model=xml, text=text))


def recorded(robot, log, *effects, noise_rad=0.0, seed=0):
    """Return a log with the positions of a robot with effects of these sizes, and noise."""
    noise = np.random.default_rng(seed).normal(0.0, noise_rad, log.joints["swing"].position.time_s.size)
    return with_signals(log, position=simulated(robot, log, *effects) + noise)


def with_signals(log, **values):
    """Return a log with other values of signals, at the times of its positions."""
    swing = log.joints["swing"]
    signals = {key: Signal(swing.position.time_s, one) for key, one in values.items()}
    return replace(log, joints={"swing": replace(swing, **signals)})


def motion(time_s, position_rad, command, name="m", joint="swing", gain=None, **others):
    """Make a log of one joint, all signals at the same times."""
    log = JointLog(position=Signal(time_s, position_rad), command=Signal(time_s, command), **others)
    return Motion(name=name, joints={joint: log}, gain=gain or {})


def waves(time_s, seed):
    """Make a command of three sines, which starts at 0 with speed 0."""
    rng = np.random.default_rng(seed)
    speeds = rng.uniform(1.0, 6.0, 3)
    return np.asarray(0.3 * np.sum(1 - np.cos(np.outer(time_s, speeds)), axis=1))


def simulated(robot, log, *effects):
    """Simulate a motion with effects of these sizes, and sample it at the times of its positions, (n,)."""
    windows = cut_windows(robot, log, None, 0.0)
    sizes = np.array([[value for _, size in effects for value in size]])
    (found,) = Engine(Models(robot), [effect for effect, _ in effects], windows, 1).positions(sizes)
    return found


def scales(torque_Nm=1.0, **others):
    """Make numbers from which effects take their bounds."""
    numbers: dict[str, float] = {
        "damping_Nms_rad": 0.02, "stiffness_Nm_rad": 0.0, "frictionloss_Nm": 0.01,
        "armature_kgm2": ARMATURE_kgm2, "low_rad": -1.0,
        "high_rad": 1.0, "speed_rad_s": 2.0, "acceleration_rad_s2": 10.0, "command_low": -1.0,
        "command_high": 1.0, "torque_Nm": torque_Nm, "hottest_degC": 40.0,
        "coldest_degC": 20.0,
    }  # fmt: skip
    return JointScales(**(numbers | others))


def at_swing(kind, robot, **others):
    """Make an effect at the joint of the pendulum."""
    return kind.at(robot, "swing", {"swing": scales(**others)})

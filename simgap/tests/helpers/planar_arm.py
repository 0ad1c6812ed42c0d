"""A planar arm of two joints over a table, simulated in place of a real one, and its slow motions."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np

from simgap.command.check import simulate_nominal
from simgap.logs import JointLog, Logs, Motion, Signal
from simgap.robot import ControlMode, Robot, RobotJoint
from simgap.simulation.compiled import Models

RATE_HZ = 50.0
DURATION_S = 12.0
COUNT_RAD = 2 * np.pi / 4096
TABLE_M = -0.1
"""Height of the tip of the tool when it lies on the table."""
MODEL = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    {table}
    <body name="upper" pos="0 0 0.3">
      <joint name="shoulder" axis="0 1 0" armature="0.02" damping="0.1" frictionloss="0.05"
             range="-1.6 1.6" limited="true"/>
      <inertial pos="0.125 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
      <body name="fore" pos="0.25 0 0">
        <joint name="elbow" axis="0 1 0" armature="0.02" damping="0.1" frictionloss="0.05"
               range="-2 2" limited="true"/>
        <inertial pos="0.125 0 0" mass="0.3" diaginertia="0.002 0.002 0.002"/>
        <site name="tip" pos="0.25 0 0"/>
        {ball}
      </body>
    </body>
  </worldbody>
</mujoco>
"""
TABLE = f'<geom type="plane" size="1 1 1" pos="0 0 {TABLE_M - 0.01}" friction="0.1"/>'
BALL = '<geom type="sphere" size="0.01" pos="0.25 0 0" friction="0.1"/>'


def planar_arm(table=False, torque_limit_Nm=8.0):
    """Return the arm; with a table it stands for the real one."""
    text = MODEL.format(table=TABLE if table else "", ball=BALL if table else "")
    model = mujoco.MjModel.from_xml_string(text)
    joints = tuple(
        RobotJoint(name, k, k, ControlMode.POSITION, 20.0, 1.0, torque_limit_Nm)
        for k, name in enumerate(("shoulder", "elbow"))
    )
    return Robot("planar arm", model, text, joints, 0.002, "tip")


def commands(number, low, high):
    """Return slow commands of one motion: the shoulder swings between two angles, the elbow differs."""
    time_s = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    swing = 0.5 - 0.5 * np.cos(2 * np.pi * time_s / 6.0)
    elbow = 0.2 + 0.1 * number + 0.15 * np.sin(2 * np.pi * time_s / 12.0)
    return {"shoulder": low + (high - low) * swing, "elbow": elbow}


def record(real, number, sent, arrived=None):
    """Record a motion of the real arm; `arrived` are the commands if they differ from what was sent."""
    arrived = arrived or sent
    time_s = np.arange(sent["shoulder"].size) / RATE_HZ
    start = {name: np.full(time_s.size, value[0]) for name, value in arrived.items()}
    before = motion(number, time_s, start, arrived)
    found = simulate_nominal(Models(real), before).position
    position = {name: np.round(value / COUNT_RAD) * COUNT_RAD for name, value in found.items()}
    return motion(number, time_s, position, sent)


def motion(number, time_s, position, command):
    """Return a motion from arrays."""
    pairs = {name: (Signal(time_s, one), Signal(time_s, command[name])) for name, one in position.items()}
    joints = {name: JointLog(position=one, command=sent) for name, (one, sent) in pairs.items()}
    return Motion(f"motion {number}", joints, {})


def slow_logs(real, low=-0.6, high=0.4, count=4):
    """Return slow motions of the real arm; the same ones are recorded once."""
    return _slow_logs(real.model.ngeom > 0, real.joints[0].torque_limit_Nm, low, high, count)


@cache
def _slow_logs(table, torque_limit_Nm, low, high, count):
    real = planar_arm(table, torque_limit_Nm)
    return Logs(tuple(record(real, k, commands(k, low, high)) for k in range(count)))


def with_joint(logs, joint, change):
    """Return logs in which a function has changed the log of one joint in each motion."""
    changed = [(one, {joint: change(one.joints[joint])}) for one in logs.motions]
    return replace(logs, motions=tuple(replace(one, joints=one.joints | new) for one, new in changed))

"""Variables of the measured motion on which a residual may depend."""

from collections.abc import Sequence

import mujoco
import numpy as np

from simgap.arrays import Array, Integers
from simgap.logs import Motion, Signal
from simgap.robot import Robot

SMOOTH_SAMPLES = 5
"""Samples of the straight lines that give speeds and accelerations, as at the start of windows."""


def measured_variable(
    robot: Robot, motions: Sequence[Motion], name: str, motion_of: Integers, joint_of: Integers, time_s: Array
) -> Array:
    """Interpolate a variable of the measured motion.

    Args:
        motions: Its logs.
        name: "position" [rad], "velocity" [rad/s], "load" [N m], "time" [s], "temperature" [degC],
            "command".
        motion_of: Index of the motion of each value, (n,).
        joint_of: Index of the joint, (n,).
        time_s: Time in the motion, (n,) [s].

    Returns:
        Values, (n,); NaN where the variable is not logged.
    """
    if name == "time":
        return time_s.copy()
    value = np.full(time_s.size, np.nan)
    for m, motion in enumerate(motions):
        of_motion = motion_of == m
        for j, joint in enumerate(robot.joints):
            here = np.flatnonzero(of_motion & (joint_of == j))
            log = motion.joints.get(joint.name)
            if log is None or not here.size:
                continue
            if name == "load":
                value[here] = _load_Nm(robot, motion, j, time_s[here])
                continue
            signal = {
                "position": log.position,
                "velocity": slopes(log.position),
                "temperature": log.temperature,
                "command": log.command,
            }[name]
            if signal is not None:
                value[here] = np.interp(time_s[here], signal.time_s, signal.value)
    return value


def slopes(signal: Signal) -> Signal:
    """Differentiate a signal by straight lines through some neighbouring samples.

    Args:
        signal: Signal of n samples.

    Returns:
        Slopes at the middles of the lines.
    """
    n = min(SMOOTH_SAMPLES, signal.time_s.size)
    t = np.lib.stride_tricks.sliding_window_view(signal.time_s, n)
    x = np.lib.stride_tricks.sliding_window_view(signal.value, n)
    middle = t.mean(axis=1, keepdims=True)
    spread = np.sum((t - middle) ** 2, axis=1)
    return Signal(middle[:, 0], np.sum((t - middle) * x, axis=1) / spread)


def _load_Nm(robot: Robot, motion: Motion, j: int, time_s: Array) -> Array:
    """Compute `State.load_Nm` of a joint at the measured motion."""
    model, data = robot.model, mujoco.MjData(robot.model)
    q, v, a = (np.zeros((time_s.size, len(robot.joints))) for _ in range(3))
    for i, joint in enumerate(robot.joints):
        log = motion.joints.get(joint.name)
        if log is None:
            continue
        speed = slopes(log.position)
        acceleration = slopes(speed)
        q[:, i] = np.interp(time_s, log.position.time_s, log.position.value)
        v[:, i] = np.interp(time_s, speed.time_s, speed.value)
        a[:, i] = np.interp(time_s, acceleration.time_s, acceleration.value)
    qpos = [joint.qpos_index for joint in robot.joints]
    dof = [joint.dof_index for joint in robot.joints]
    load, torque = np.empty(time_s.size), np.empty(model.nv)
    for k in range(time_s.size):
        data.qpos[qpos], data.qvel[dof], data.qacc[dof] = q[k], v[k], a[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, torque)
        load[k] = torque[robot.joints[j].dof_index]
    return load

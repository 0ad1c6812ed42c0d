"""Gains of position loops that the motion shows, by the torques that it needs.

The inverse dynamics of the model gives the torque of each joint, and a loop makes it of the error of its
command: torque = kp (command - position) - kd velocity. Least squares gives kp. Delays and wrong friction
bias it, so it is no measurement; where gravity does not move a joint, friction decides, and none is given.
"""

import copy
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.checks.records import hold
from simgap.common.errors import RobotError
from simgap.logs import Motion
from simgap.residuals.filtered_motion import LowPass, choose_filter, filter_motion, inverse_dynamics
from simgap.robot import ControlMode, Robot

MAX_ROWS: Final = 20_000
"""Rows that are used, at least one motion: they take a second, and more make no estimate better."""
EXPLAINED: Final = 0.5
"""Share of the torque, as mean squares, that a loop must explain."""


def loop_gains(robot: Robot, motions: Sequence[Motion]) -> dict[str, float]:
    """Return the gains of position loops [N m/rad], for a value of 1 in a gain column, by joint.

    Joints that gravity does not move, and those whose torques no loop explains, have none.
    """
    rows = np.cumsum([0, *(one.joints[robot.joints[0].name].position.value.size for one in motions)])
    chosen = [one for one, before in zip(motions, rows[:-1], strict=True) if before < MAX_ROWS]
    try:
        low_pass = choose_filter(robot, chosen)
        parts = [_signals(robot, one, low_pass) for one in chosen]
    except (RobotError, ValueError):  # too short for a filter
        return {}
    gains = {one: _fit(np.concatenate([part[one] for part in parts if one in part])) for one in parts[0]}
    return {joint: gain for joint, gain in gains.items() if gain > 0.0}


def _signals(robot: Robot, motion: Motion, low_pass: LowPass) -> dict[str, Array]:
    """Return the error of the command, the velocity, and the torque that it needs, (n, 3), by joint."""
    one = filter_motion(robot, motion, low_pass)
    rows = slice(0, MAX_ROWS)
    q, v, a = one.q_rad[rows], one.v_rad_s[rows], one.a_rad_s2[rows]
    needed, _ = inverse_dynamics(copy.copy(robot.model), robot, q, v, a)
    found: dict[str, Array] = {}
    for j, joint in enumerate(robot.joints):
        log, dof = motion.joints.get(joint.name), joint.dof_index
        is_asked = joint.mode is ControlMode.POSITION and joint.is_loaded_by_gravity
        if log is None or log.command is None or not is_asked:
            continue
        slow_rad_s = max(float(low_pass.friction_speed_rad_s[j]), 1e-3)
        own = robot.model.dof_armature[dof] * a[:, j] + robot.model.dof_damping[dof] * v[:, j]
        own += robot.model.dof_frictionloss[dof] * np.tanh(v[:, j] / slow_rad_s)
        error = motion.gain.get(joint.name, 1.0) * (low_pass(hold(log.command, one.time_s))[rows] - q[:, j])
        table = np.column_stack([error, v[:, j], needed[:, j] + own])
        found[joint.name] = table if log.enabled is None else table[hold(log.enabled, one.time_s)[rows] > 0.5]
    return found


def _fit(table: Array) -> float:
    """Return the gain, NaN if a loop does not explain the torques."""
    signals, needed = table[:, :2], table[:, 2]
    factors = np.linalg.lstsq(signals, needed)[0]
    rest = float(np.sum((needed - signals @ factors) ** 2))
    return float(factors[0]) if rest < (1.0 - EXPLAINED) * float(np.sum(needed**2)) else math.nan

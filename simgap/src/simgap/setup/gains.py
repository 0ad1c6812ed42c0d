"""Gains, limits and torque constants that neither model nor robot file gives: estimates and questions."""

import copy
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.checks.records import hold
from simgap.checks.static import find_rest, fit_static_law
from simgap.common.errors import RobotError
from simgap.common.toml import parse_record
from simgap.files.robot_file import RobotFile
from simgap.logs import Logs, Motion
from simgap.mjcf import gravity_amplitudes, read_drive
from simgap.residuals.filtered_motion import LowPass, choose_filter, filter_motion, inverse_dynamics
from simgap.robot import ControlMode, Robot, has_torque
from simgap.setup.draft import Draft

BANDWIDTH_Hz: Final = 5.0
"""Natural frequency of a position loop of which nothing is known: arms have 2 to 10 Hz."""
SHOWS_SAG: Final = 0.5
"""Least correlation of the error at rest with the gravity torque for which it gives a gain."""
FAR: Final = 3.0
"""Ratio of two gains from which they contradict each other: friction and few poses at rest make 2."""
MOTOR_SIDE: Final = 10.0
"""Gravity torque of the model over a logged torque from which it may be that of a motor before its gear."""


def set_unknown_gains(draft: Draft, model: mujoco.MjModel, path: Path) -> list[str] | None:
    """Set a gain of 1 where positions are compared and none is known, and guess that of a velocity loop.

    Returns:
        These joints; None where torques are compared.
    """
    file = parse_record(RobotFile, draft.content, path)
    drives = {
        joint: read_drive(table, model, model.joint(joint).id, f"{path}: joints.{joint}")
        for joint, table in file.joints.items()
    }
    if all(has_torque(table, drives[joint]) for joint, table in file.joints.items()):
        return None
    unknown = []
    for joint, table in file.joints.items():
        drive, own = drives[joint], draft.joint(joint)
        if table.mode == "position" and (drive.kp_Nm_rad == 0.0 or table.gain_column):
            own["kp_Nm_rad"] = 1.0
            unknown.append(joint)
        elif table.mode == "velocity" and drive.kd_Nms_rad == 0.0:
            own["kd_Nms_rad"] = float(f"{_inertia(model, joint) * math.tau * BANDWIDTH_Hz:.3g}")
            question = f"what is the gain of the velocity loop? This is a guess, for {BANDWIDTH_Hz:g} Hz"
            draft.ask(question, "joints", joint, "kd_Nms_rad")
    return unknown


def _inertia(model: mujoco.MjModel, joint: str) -> float:
    """Return the inertia of the model about a joint at its zero, with the rotor [kg m^2]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dof = int(model.joint(joint).dofadr[0])
    return float(full[dof, dof])


def sag_gains(robot: Robot, logs: Logs) -> dict[str, float]:
    """Return the gains of position loops that their sag under gravity shows [N m/rad], by joint."""
    rest, found = find_rest(robot, logs.motions), {}
    for place, joint in enumerate(rest.joints):
        law = fit_static_law(robot, logs.motions, rest, place, np.zeros(rest.time_s.size, np.bool_))
        if law is None or law.weight[0] <= 0.0 or min(np.ptp(law.error), np.ptp(law.load_Nm)) == 0.0:
            continue
        if np.corrcoef(law.error, law.load_Nm)[0, 1] > SHOWS_SAG:
            found[joint] = 1.0 / float(law.weight[0])
    return found


def ask_about_gains(draft: Draft, robot: Robot, shown: Mapping[str, float]) -> None:
    """Ask about gains of the model, but where the logs show the same, by joint [N m/rad]."""
    own = [one for one in robot.joints if one.mode is ControlMode.POSITION]
    own = [one for one in own if "kp_Nm_rad" not in draft.joint(one.name)]
    for gain in dict.fromkeys(one.kp_Nm_rad for one in own):
        same = [one for one in own if one.kp_Nm_rad == gain]
        seen = {one.name: shown[one.name] for one in same if one.name in shown}
        far = {name: kp for name, kp in seen.items() if max(kp / gain, gain / kp) > FAR}
        listed = ", ".join(f"{kp:.2g} ({name})" for name, kp in far.items())
        said = f"; the logs look like {listed}" if far else ""
        for one in same if far or not seen else ():
            text = f"is {gain:.4g} {one.effort_unit}/{one.unit}, the gain of the model, that of the robot"
            draft.ask(f"{text}{said}? kp_Nm_rad says another", "joints", one.name, "mode")


def estimate_gain(draft: Draft, robot: Robot, logs: Logs, joint: str, sag: float | None) -> None:
    """Set the gain of a position loop by its sag under gravity; else guess it by the inertia."""
    table, key = draft.joint(joint), ("joints", joint, "kp_Nm_rad")
    unit = "N/m" if robot.joint(joint).is_slide else "N m/rad"
    of_column = " for a gain of 1" if "gain_column" in table else ""
    draft.ask(f"what is the gain of the servo in {unit}{of_column}, and what is its damping?", *key)
    if sag is not None:
        table["kp_Nm_rad"] = float(f"{sag:.3g}")
        draft.reasons[key] = f"by how far the joint sags under gravity{of_column}"
        return
    gains = [motion.gain.get(joint, 1.0) for motion in logs.motions]
    inertia, rate = _inertia(robot.model, joint), math.tau * BANDWIDTH_Hz
    table["kp_Nm_rad"] = float(f"{inertia * rate**2 / float(np.median(gains)):.3g}")
    draft.reasons[key] = f"a guess{of_column}: {BANDWIDTH_Hz:g} Hz with the inertia of the model"
    if not of_column:
        table["kd_Nms_rad"] = float(f"{2.0 * inertia * rate:.3g}")
        draft.reasons["joints", joint, "kd_Nms_rad"] = "a guess: critical damping"


def ask_about_torques(draft: Draft, robot: Robot, logs: Logs) -> None:
    """Ask for torque limits, torque constants, and whether a small torque is that of the motor."""
    gravity_Nm, shares = gravity_amplitudes(robot.model), {}
    for joint in robot.joints:
        table, unit = draft.joint(joint.name), joint.effort_unit
        by_torque = "torque" in table
        if not by_torque and joint.mode.value == "position" and math.isinf(joint.torque_limit_Nm):
            effort = "force" if joint.is_slide else "torque"
            question = f"what is the largest {effort} of the motor? torque_limit_Nm = .. [{unit}]"
            draft.ask(question, "joints", joint.name)
        if "current" in table and not by_torque and math.isnan(joint.torque_constant_Nm_A):
            draft.ask(
                f"what {unit} at the joint is 1 A? torque_constant_Nm_A = .. lets torques be compared; "
                "torque_constant_is_known = false fits it",
                *("joints", joint.name, "current"),
            )
        if by_torque and joint.is_loaded_by_gravity:
            own = [motion.joints[joint.name].torque for motion in logs.motions]
            largest = max((float(np.abs(one.value).max()) for one in own if one is not None), default=0.0)
            if largest > 0.0 and gravity_Nm[joint.dof_index] > MOTOR_SIDE * largest:
                shares[joint.name] = float(gravity_Nm[joint.dof_index]) / largest
    _set_torque_sides(draft, robot, shares)


def _set_torque_sides(draft: Draft, robot: Robot, shares: Mapping[str, float]) -> None:
    """Put torques at the motors, by the gears of the actuators; ask where these have none, or it is open.

    Args:
        shares: Gravity torque over the logged one, of joints where it is too large for the joint.
    """
    unknown = []
    for joint in robot.joints:
        table, k = draft.joint(joint.name), joint.actuator_index
        key = "torque" if "torque" in table else "command" if table["mode"] == "torque" else ""
        gear = abs(float(robot.model.actuator_gear[k, 0])) if k >= 0 else 1.0
        if not key:
            continue
        if gear == 1.0:
            unknown += [joint.name] * (joint.name in shares)
            continue
        if shares or key == "command":
            table[key]["side"] = "motor"
            table["gear_ratio"] = gear
            draft.reasons["joints", joint.name, "gear_ratio"] = (
                "the gear of the actuator; gravity is too large for the torques to be those of the joints"
                if shares
                else "the gear of the actuator, which takes the torque of the motor"
            )
        if not shares:
            draft.ask(
                f"is the torque that of the motor, before the gear of the actuator ({gear:.4g})? gear_ratio "
                'and side = "motor" say so',
                *("joints", joint.name, key),
            )
    if unknown:
        draft.ask(
            f"gravity takes up to {max(shares.values()):.3g} times as much as the torques of "
            f"{', '.join(unknown)}: are they those of the motors, before their gears? Write "
            'gear_ratio = .. at each joint, and side = "motor" at its torque',
            "joints",
        )


MAX_ROWS: Final = 20_000
"""Rows that are used, at least one motion: they take a second, and more make no estimate better."""
EXPLAINED: Final = 0.5
"""Share of the torque, as mean squares, that a loop must explain."""


def loop_gains(robot: Robot, motions: Sequence[Motion]) -> dict[str, float]:
    """Return the gains of position loops [N m/rad], for a value of 1 in a gain column, by joint.

    The inverse dynamics of the model gives the torque of each joint, and a loop makes it of the error of its
    command: torque = kp (command - position) - kd velocity. Least squares gives kp. Delays and wrong friction
    bias it, so it is no measurement. Joints that gravity does not move, where friction decides, and those
    whose torques no loop explains, have none.
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

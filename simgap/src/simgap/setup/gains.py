"""Gains, limits and torque constants that neither model nor robot file gives: estimates and questions."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from simgap.checks.static import find_rest, fit_static_law
from simgap.common.toml import parse_record
from simgap.drives import read_drive
from simgap.files.robot_file import RobotFile
from simgap.logs import Logs
from simgap.mjcf import gravity_amplitudes
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

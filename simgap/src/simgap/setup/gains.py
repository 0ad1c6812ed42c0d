"""Gains, limits and torque constants that neither model nor robot file gives: guesses and questions."""

import math
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from simgap.common.toml import parse_record
from simgap.files.robot_file import RobotFile
from simgap.logs import Logs
from simgap.mjcf import gravity_amplitudes, read_drive
from simgap.robot import ControlMode, Robot, has_torque
from simgap.setup.draft import Draft

BANDWIDTH_Hz: Final = 5.0
"""Natural frequency of a position loop of which nothing is known: arms have 2 to 10 Hz."""
MOTOR_SIDE: Final = 10.0
"""Gravity torque of the model over a logged torque from which it may be that of a motor before its gear."""


def guess_gains(draft: Draft, model: mujoco.MjModel, path: Path) -> bool:
    """Guess the gains of loops that have none, and ask; return False where torques are compared instead."""
    file = parse_record(RobotFile, draft.content, path)
    drives = {
        joint: read_drive(table, model, model.joint(joint).id, f"{path}: joints.{joint}")
        for joint, table in file.joints.items()
    }
    if all(has_torque(table, drives[joint]) for joint, table in file.joints.items()):
        return False
    for joint, table in file.joints.items():
        drive, own, key = drives[joint], draft.joint(joint), ("joints", joint)
        inertia, rate = _inertia(model, joint), math.tau * BANDWIDTH_Hz
        if table.mode == "position" and table.gain_column:
            own["kp_Nm_rad"] = 1.0
            draft.ask(
                "what is the gain of the servo for a gain of 1, and what is its damping?", *key, "kp_Nm_rad"
            )
        elif table.mode == "position" and drive.kp_Nm_rad == 0.0:
            own["kp_Nm_rad"] = float(f"{inertia * rate**2:.3g}")
            own["kd_Nms_rad"] = float(f"{2.0 * inertia * rate:.3g}")
            draft.ask("what is the gain of the servo, and what is its damping?", *key, "kp_Nm_rad")
            draft.reasons[*key, "kp_Nm_rad"] = f"a guess: {BANDWIDTH_Hz:g} Hz with the inertia of the model"
            draft.reasons[*key, "kd_Nms_rad"] = "a guess: critical damping"
        elif table.mode == "velocity" and drive.kd_Nms_rad == 0.0:
            own["kd_Nms_rad"] = float(f"{inertia * rate:.3g}")
            question = f"what is the gain of the velocity loop? This is a guess, for {BANDWIDTH_Hz:g} Hz"
            draft.ask(question, *key, "kd_Nms_rad")
    return True


def _inertia(model: mujoco.MjModel, joint: str) -> float:
    """Return the inertia of the model about a joint at its zero, with the rotor [kg m^2]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    dof = int(model.joint(joint).dofadr[0])
    return float(full[dof, dof])


def ask_about_gains(draft: Draft, robot: Robot) -> None:
    """Ask about the gains of position loops that the model gives."""
    for one in robot.joints:
        if one.mode is ControlMode.POSITION and "kp_Nm_rad" not in draft.joint(one.name):
            gain = f"{one.kp_Nm_rad:.4g} {one.effort_unit}/{one.unit}"
            question = f"is {gain}, the gain of the model, that of the robot? kp_Nm_rad says another"
            draft.ask(question, "joints", one.name, "mode")


def ask_about_torques(draft: Draft, robot: Robot, logs: Logs) -> None:
    """Ask for torque limits, torque constants, and whether a small torque is that of the motor."""
    gravity_Nm, shares = gravity_amplitudes(robot.model), {}
    for joint in robot.joints:
        table, unit = draft.joint(joint.name), joint.effort_unit
        by_torque, k = "torque" in table, joint.actuator_index
        gear = abs(float(robot.model.actuator_gear[k, 0])) if k >= 0 else 1.0
        if gear != 1.0 and (by_torque or table["mode"] == "torque"):
            draft.ask(
                f"is the torque that of the motor, before the gear of the actuator ({gear:.4g})? gear_ratio "
                'and side = "motor" say so',
                *("joints", joint.name, "torque" if by_torque else "command"),
            )
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
    if shares:
        draft.ask(
            f"gravity takes up to {max(shares.values()):.3g} times as much as the torques of "
            f"{', '.join(shares)}: are they those of the motors, before their gears? Write "
            'gear_ratio = .. at each joint, and side = "motor" at its torque',
            "joints",
        )

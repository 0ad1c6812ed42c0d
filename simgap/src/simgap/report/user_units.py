"""Errors in the units in which a user logs: degrees, and torques of the motor side."""

from dataclasses import replace
from math import degrees

from simgap.report.traces import Trace
from simgap.result import Diagnosis, JointError, Remainder
from simgap.robot import Robot

MOTOR_SIDE = "N m of the motor"


def find_user_unit(robot: Robot, joint: str, unit: str) -> tuple[str, float]:
    """Return the unit in which a joint is logged for one of the engine, and what errors are multiplied by."""
    table = None if robot.file is None else robot.file.joints.get(joint)
    if table is None:
        return unit, 1.0
    if unit == "rad" and table.position.unit == "deg":
        return "deg", degrees(1.0)
    if unit in ("N m", "N") and table.torque is not None and table.torque.side == "motor":
        return MOTOR_SIDE, 1.0 / table.gear_ratio
    return unit, 1.0


def convert_errors(robot: Robot, diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis whose errors and remainders are in the units of the user."""
    return replace(
        diagnosis,
        errors=tuple(_convert_error(robot, one) for one in diagnosis.errors),
        remaining=tuple(_convert_remainder(robot, one) for one in diagnosis.remaining),
    )


def convert_trace(robot: Robot, trace: Trace) -> Trace:
    """Return a trace in the unit of the user."""
    unit, factor = find_user_unit(robot, trace.joint, trace.unit)
    measured = None if trace.measured is None else factor * trace.measured
    explained = factor * trace.explained
    return replace(trace, unit=unit, measured=measured, nominal=factor * trace.nominal, explained=explained)


def _convert_error(robot: Robot, one: JointError) -> JointError:
    unit, factor = find_user_unit(robot, one.joint, one.unit)
    numbers = ("nominal", "base", "explained", "noise_floor")
    return replace(one, unit=unit, **{name: factor * getattr(one, name) for name in numbers})


def _convert_remainder(robot: Robot, one: Remainder) -> Remainder:
    unit, factor = find_user_unit(robot, one.joint, one.unit)
    return replace(one, unit=unit, mean_abs=factor * one.mean_abs)

"""Columns of a first robot file, with their units and what says them."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import mujoco
import numpy as np

from simgap.checks.units import speed_ratio
from simgap.files.log_file import LogFile
from simgap.logs import Logs
from simgap.robot import Robot
from simgap.setup.draft import Draft
from simgap.setup.matching import Match
from simgap.setup.units import (
    UnitGuess,
    describe_values,
    fits_speed,
    guess_position_units,
    guess_speed_unit,
    si_unit,
)

SIGNALS: Final = ("command", "position", "secondary", "velocity", "torque", "current", "voltage")
KEYS: Final = (*SIGNALS, "temperature", "enabled")
"""Keys of a joint with a column, in the order of the file."""


def write_columns(
    draft: Draft,
    logs: Sequence[LogFile],
    model: mujoco.MjModel,
    by_joint: Mapping[str, Mapping[str, Match]],
    unit: str,
    grippers: Sequence[str],
) -> None:
    """Write the columns of all joints with their units."""
    slides = {joint: model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE for joint in by_joint}
    values = {}
    for joint, match in by_joint.items():
        value = np.concatenate([log.numbers(match["position"].info.name).value for log in logs])
        known = model.joint(joint)
        limits = known.range if model.jnt_limited[known.id] else (-math.inf, math.inf)
        values[joint] = describe_values(value, (float(limits[0]), float(limits[1])), slides[joint])
    positions = guess_position_units(values, unit, grippers)
    for joint, own in by_joint.items():
        table = draft.joint(joint)
        gain = own.get("gain")
        if gain is not None and gain.info.lowest != gain.info.highest and table["mode"] == "position":
            table |= {"gain_column": gain.info.name, "kp_Nm_rad": 1.0}
            draft.reasons["joints", joint, "gain_column"] = "by its name"
        for key in KEYS:
            if key in own:
                signal = table["mode"] if key == "command" else "position" if key == "secondary" else key
                guess = _unit_of(own[key], signal, positions[joint], own["position"], slides[joint])
                table[key] = {"column": own[key].info.name, "unit": guess.unit, **guess.keys}
                draft.reasons["joints", joint, key] = f"{own[key].reason}; {guess.unit}: {guess.reason}"
                if key == "position":
                    draft.ask(guess.question, "joints", joint, key)


def _unit_of(one: Match, signal: str, position: UnitGuess, measured: Match, is_slide: bool) -> UnitGuess:
    """Return the unit of a column: of its name, of the file, or a guess."""
    if one.name.unit and one.name.unit != "count":
        return UnitGuess(one.name.unit, "it stands in the name")
    if one.info.unit:
        return UnitGuess(one.info.unit, "the file says so")
    if signal == "position":
        of_position = measured.name.unit or measured.info.unit
        if of_position and of_position != "count":
            return UnitGuess(of_position, "as the position")
        return position
    return si_unit(signal, is_slide)


def settle_speeds(
    draft: Draft, robot: Robot, logs: Logs, by_joint: Mapping[str, Mapping[str, Match]]
) -> None:
    """Set the unit of velocities by the change of the positions, or leave them away where none fits."""
    ratios = {
        joint: speed_ratio(logs.motions, joint)
        for joint, own in by_joint.items()
        if "velocity" in own and not (own["velocity"].name.unit or own["velocity"].info.unit)
    }
    for is_slide in (False, True):
        own = {joint: one for joint, one in ratios.items() if robot.joint(joint).is_slide == is_slide}
        unit = guess_speed_unit(list(own.values()), is_slide)
        for joint, ratio in own.items():
            match, table = by_joint[joint]["velocity"], draft.joint(joint)
            if math.isnan(ratio) or fits_speed(ratio, unit):
                table["velocity"]["unit"] = unit
                draft.reasons["joints", joint, "velocity"] = (
                    f"{match.reason}; {unit} fits the change of positions"
                )
                continue
            del table["velocity"]
            draft.ask(
                f"{match.info.name} is {ratio:.3g} times the change of the position, if it is in {unit}: has "
                f"the position another unit{_ask_fraction(robot, logs, joint)}? Until then the velocity is "
                "left away",
                *("joints", joint, "position"),
            )


def _ask_fraction(robot: Robot, logs: Logs, joint: str) -> str:
    """Return the keys of a position that is a share of the range; empty if it cannot be one."""
    values = np.concatenate([motion.joints[joint].position.value for motion in logs.motions])
    low, high = robot.range_rad(joint)
    if values.min() < 0.0 or values.max() > 1.0 or not math.isfinite(high):
        return ""
    return f', such as unit = "fraction", at_0_rad = {low:.6g}, at_1_rad = {high:.6g}'

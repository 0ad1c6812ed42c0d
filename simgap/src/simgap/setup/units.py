"""Columns of a first robot file with their units: by the range of the model, and by other signals."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import mujoco
import numpy as np

from simgap.checks.units import CLOSE, is_near, speed_ratio
from simgap.files.log_file import LogFile
from simgap.files.robot_file import SIGNALS
from simgap.logs import Logs
from simgap.robot import Robot
from simgap.setup.column_names import Match
from simgap.setup.draft import Draft
from simgap.units import UNITS

COUNTS: Final = 4096
"""Counts of a turn of most bus servos; finer encoders have a power of two more."""
WHOLE: Final = 30.0
"""Range of whole numbers from which they are counts: a log in whole degrees shows no error of a servo."""
TOLD: Final = "as --unit says"
PERCENT: Final = 100.5
"""Largest position in percent of a range, with rounding."""
SPEEDS: Final = ("rad/s", "deg/s", "rpm", "turn/s")
LINEAR_SPEEDS: Final = ("m/s", "mm/s")


@dataclass(frozen=True, slots=True)
class Values:
    """Logged positions of a joint, and the range of its model."""

    low: float
    high: float
    are_whole: bool
    range_rad: tuple[float, float]
    """Infinite without limits; m of a slide."""
    is_slide: bool = False


@dataclass(frozen=True, slots=True)
class UnitGuess:
    """Unit of a column, with the keys that it needs."""

    unit: str
    reason: str
    keys: Mapping[str, Any] = field(default_factory=dict)
    question: str = ""


IN_RAD: Final = UnitGuess("rad", "all positions lie within the range of the model in rad")


def guess_position_units(
    values: Mapping[str, Values], unit: str = "", grippers: Sequence[str] = ()
) -> dict[str, UnitGuess]:
    """Guess the unit of positions without one in their names, one for all hinges and one for all slides.

    Args:
        values: Logged positions by joint.
        unit: Unit of the hinges, as the user gives it; empty: it is guessed.
        grippers: Joints of LeRobot that are logged in percent of their range, whatever the others are.
    """
    found = {joint: _percent(values[joint], 0.0, "LeRobot has grippers in percent") for joint in grippers}
    for is_slide in (False, True):
        own = {joint: one for joint, one in values.items() if one.is_slide == is_slide and joint not in found}
        if own and unit == "count" and not is_slide:
            found |= dict.fromkeys(own, _counts(tuple(own.values()), TOLD))
        elif own and unit and not is_slide:
            is_share, plain = unit == "percent", UnitGuess(unit, TOLD)
            found |= {key: _percent(one, -100.0, TOLD) if is_share else plain for key, one in own.items()}
        elif own:
            found |= _guess_slides(own) if is_slide else _guess_hinges(own)
    return found


def _counts(values: Sequence[Values], reason: str) -> UnitGuess:
    """Return counts of a turn; where none is below 0, the zero of the model is in the middle."""
    is_signed = min(one.low for one in values) < 0.0
    highest = max(one.high for one in values)
    turns = [COUNTS * 2**k for k in range(13)]
    fitting = [n for n in turns if (_fits(values, CLOSE * math.tau / n) if is_signed else highest < n)]
    n = next(iter(fitting), COUNTS)
    keys = {"counts_per_turn": n} | ({} if is_signed else {"zero_rad": round(-math.pi, 6)})
    asked = f"is a turn {n} counts? zero_rad and factor = -1 say another zero and direction"
    return UnitGuess("count", reason, keys, asked)


def _percent(one: Values, lowest: float, reason: str) -> UnitGuess:
    """Return percent of the range of the model, from 0 or from -100 on."""
    low, high = one.range_rad if math.isfinite(one.range_rad[1]) else (-math.pi, math.pi)
    start = low if lowest == 0.0 else (low + high) / 2.0
    keys = {"at_0_rad": round(start, 6) + 0.0, "at_1_rad": round(high, 6)}
    asked = (
        f"is {lowest:g}..100 % the range of the model? at_0_rad and at_1_rad are the positions at 0 and 100 %"
    )
    return UnitGuess("percent", reason, keys, asked)


def _guess_hinges(values: Mapping[str, Values]) -> dict[str, UnitGuess]:
    every = tuple(values.values())
    if _fits(every, 1.0):
        return dict.fromkeys(values, IN_RAD)
    if all(one.are_whole for one in every) and max(one.high - one.low for one in every) > WHOLE:
        return dict.fromkeys(values, _counts(every, "whole numbers"))
    if (zeros := _quarter_turns(values)) is not None:
        return {joint: _moved(one, zeros[joint]) for joint, one in values.items()}
    reason = "all positions lie within the range of the model in degrees, and beyond it in rad"
    if not _fits(every, UNITS["deg"].factor):
        reason = "no unit fits the range of the model"
    inside = max(max(abs(one.low), abs(one.high)) for one in every) <= PERCENT
    asked = "are these degrees, or percent of the range? For percent, write the file anew with --unit percent"
    return dict.fromkeys(values, UnitGuess("deg", reason, question=asked if inside else ""))


def _quarter_turns(values: Mapping[str, Values]) -> dict[str, int] | None:
    """Return the quarter turns to add to hinges in rad, so that all lie within the model; None if none do.

    Encoders are mounted a quarter or a half of a turn off; a log in degrees moves too far to fit.
    """
    found = {}
    for joint, one in values.items():
        low, high = one.range_rad if math.isfinite(one.range_rad[1]) else (-math.tau, math.tau)
        turns_rad = {n: n * math.pi / 2.0 for n in (0, 1, -1, 2, -2)}
        beyond = {n: max(low - one.low - by, one.high + by - high, 0.0) for n, by in turns_rad.items()}
        room = (CLOSE - 1.0) * max(abs(low), abs(high))
        found[joint] = 0 if beyond[0] <= room else min(beyond, key=lambda n: beyond[n])
        if beyond[found[joint]] > room:
            return None
    return found


def _moved(one: Values, n_quarters: int) -> UnitGuess:
    """Return rad, and ask whether the zero of a joint is another one."""
    if n_quarters == 0:
        return IN_RAD
    end = max(abs(one.low), abs(one.high))
    asked = (
        f"the positions reach {end:.3g} rad and the model {max(map(abs, one.range_rad)):.3g}: is the zero of "
        "the log another one, as zero_rad says here? Or are these degrees? Then write the file anew with "
        "--unit deg"
    )
    zero_rad = round(n_quarters * math.pi / 2.0, 6)
    return UnitGuess("rad", "so that the positions lie within the model", {"zero_rad": zero_rad}, asked)


def _guess_slides(values: Mapping[str, Values]) -> dict[str, UnitGuess]:
    every = tuple(values.values())
    is_m = _fits(every, 1.0)
    fits = "all positions lie within the range of the model in m"
    reason = fits if is_m else "in m they would lie beyond it"
    return dict.fromkeys(values, UnitGuess("m" if is_m else "mm", reason))


def _fits(values: Sequence[Values], factor: float) -> bool:
    """Return whether values lie within the ranges of the model, and a hinge without limits within a turn."""
    for one in values:
        ends = [abs(end) for end in one.range_rad]
        allowed = max(ends) if math.isfinite(max(ends)) else math.tau
        if max(abs(one.low), abs(one.high)) * factor > CLOSE * allowed:
            return False
    return True


def guess_speed_unit(ratios: Sequence[float], is_slide: bool) -> str:
    """Guess the unit of velocities by their ratios to the change of the position; NaN counts for nothing."""
    units = LINEAR_SPEEDS if is_slide else SPEEDS
    known = [one for one in ratios if one > 0.0]
    fitting = {unit: sum(fits_speed(one, unit) for one in known) for unit in units}
    return max(units, key=lambda one: fitting[one])


def fits_speed(ratio: float, unit: str) -> bool:
    """Return whether a logged velocity in a unit is this ratio times the true one."""
    return is_near(ratio * UNITS[unit].factor, 1.0)


KEYS: Final = (
    *("command", "position", "secondary", "velocity", "torque", "current", "voltage"),
    *("temperature", "enabled"),
)
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
        value = value[np.isfinite(value)]
        ends = (float(value.min()), float(value.max())) if value.size else (0.0, 0.0)
        are_whole, known = bool(np.all(value == np.round(value))), model.joint(joint)
        low, high = known.range if model.jnt_limited[known.id] else (-math.inf, math.inf)
        values[joint] = Values(*ends, are_whole, (float(low), float(high)), slides[joint])
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
    quantity = SIGNALS[signal][-1 if is_slide else 0]
    first = next(name for name, one in UNITS.items() if one.quantity is quantity)
    return UnitGuess(first, "nothing in the log says another unit")


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
                said = f"{match.reason}; {unit} fits the change of positions"
                draft.reasons["joints", joint, "velocity"] = said
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

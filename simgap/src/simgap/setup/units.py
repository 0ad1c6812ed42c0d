"""Units of logged values without a robot file, by the range of the model and by other signals."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from simgap.checks.units import CLOSE, is_near
from simgap.files.robot_file import SIGNALS
from simgap.units import UNITS

COUNTS: Final = 4096
"""Counts of a turn of most bus servos."""
WHOLE: Final = 30.0
"""Range of whole numbers from which they are counts: a log in whole degrees shows no error of a servo."""
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


def guess_position_units(values: Mapping[str, Values]) -> dict[str, UnitGuess]:
    """Guess the unit of positions without one in their names, one for all hinges and one for all slides."""
    found: dict[str, UnitGuess] = {}
    for is_slide in (False, True):
        own = {joint: one for joint, one in values.items() if one.is_slide == is_slide}
        if own:
            found |= _guess_slides(own) if is_slide else _guess_hinges(own)
    return found


def _guess_hinges(values: Mapping[str, Values]) -> dict[str, UnitGuess]:
    every = tuple(values.values())
    if _fits(every, 1.0):
        return dict.fromkeys(
            values, UnitGuess("rad", "all positions lie within the range of the model in rad")
        )
    if all(one.are_whole for one in every) and max(one.high - one.low for one in every) > WHOLE:
        is_signed = min(one.low for one in every) < 0.0
        zero_rad = 0.0 if is_signed else round(-math.pi, 6)
        asked = f"is a turn {COUNTS} counts? zero_rad and factor = -1 say another zero and direction"
        keys = {"counts_per_turn": COUNTS} | ({"zero_rad": zero_rad} if zero_rad else {})
        guess = UnitGuess("count", "whole numbers", keys, asked)
        return dict.fromkeys(values, guess)
    reason = "all positions lie within the range of the model in degrees, and beyond it in rad"
    if not _fits(every, UNITS["deg"].factor):
        reason = "no unit fits the range of the model"
    return {joint: UnitGuess("deg", reason, question=_ask_percent(one)) for joint, one in values.items()}


def _ask_percent(one: Values) -> str:
    """Return the question whether degrees are percent of the range, which the values cannot tell."""
    low, high = one.range_rad
    if max(abs(one.low), abs(one.high)) > 100.0 or not math.isfinite(high - low):
        return ""
    share, zero_rad = ("-100..100", (low + high) / 2.0) if one.low < 0.0 else ("0..100", low)
    zero_rad = 0.0 if abs(zero_rad) < 1e-6 * (high - low) else zero_rad
    return (
        f"or is it percent of the range, {share}? Then write in position and command "
        f'unit = "percent", at_0_rad = {zero_rad:.6g}, at_1_rad = {high:.6g}'
    )


def _guess_slides(values: Mapping[str, Values]) -> dict[str, UnitGuess]:
    every = tuple(values.values())
    is_m = _fits(every, 1.0)
    reason = (
        "all positions lie within the range of the model in m" if is_m else "in m they would lie beyond it"
    )
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


def si_unit(key: str, is_slide: bool) -> UnitGuess:
    """Return the unit that is taken for a signal where nothing says another: the first of its quantity."""
    quantity = SIGNALS[key][-1 if is_slide else 0]
    unit = next(name for name, one in UNITS.items() if one.quantity is quantity)
    return UnitGuess(unit, "nothing in the log says another unit")


def describe_values(value: np.ndarray[Any, Any], range_rad: tuple[float, float], is_slide: bool) -> Values:
    """Describe the logged numbers of a joint, (n,)."""
    known = value[np.isfinite(value)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    return Values(low, high, bool(np.all(known == np.round(known))), range_rad, is_slide)

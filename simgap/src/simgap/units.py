"""Units of logged values, and their conversion to SI units."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from math import isfinite
from typing import Final


class Quantity(StrEnum):
    """Kinds of logged values."""

    ANGLE = "angle"
    LENGTH = "length"
    SPEED = "angular speed"
    TORQUE = "torque"
    CURRENT = "current"
    VOLTAGE = "voltage"
    TEMPERATURE = "temperature"
    TIME = "time"
    FLAG = "flag"
    LINEAR_SPEED = "speed"
    ACCELERATION = "acceleration"
    ANGULAR_ACCELERATION = "angular acceleration"
    FORCE = "force"
    ENERGY = "energy"
    POWER = "power"
    PRESSURE = "pressure"
    FREQUENCY = "frequency"
    MASS = "mass"
    RATIO = "pure number"


@dataclass(frozen=True, slots=True)
class Unit:
    """Value in SI units = factor times logged value, plus offset."""

    quantity: Quantity
    factor: float
    offset: float = 0.0


COUNTS: Final = frozenset({"count", "count/s"})
"""Units whose factor is divided by the counts of a turn."""
SHARES: Final = {"fraction": 1.0, "percent": 100.0}
"""Units of an angle that is logged as a share of a range -> value of the whole range."""
_DEG, _TURN = math.pi / 180, 2 * math.pi
UNITS: Final = {
    name: Unit(kind, factor)
    for kind, factors in {
        Quantity.ANGLE: {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": _DEG, "turn": _TURN, "count": _TURN}
        | {name: 1.0 / whole for name, whole in SHARES.items()},
        Quantity.LENGTH: {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
        Quantity.SPEED: {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEG, "rpm": _TURN / 60}
        | dict.fromkeys(("turn/s", "count/s"), _TURN),
        Quantity.TORQUE: {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3},
        Quantity.CURRENT: {"A": 1.0, "mA": 1e-3},
        Quantity.VOLTAGE: {"V": 1.0, "mV": 1e-3},
        Quantity.TEMPERATURE: {"degC": 1.0},
        Quantity.TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
        Quantity.FLAG: {"flag": 1.0},
        Quantity.LINEAR_SPEED: {"m/s": 1.0, "mm/s": 1e-3},
        Quantity.ACCELERATION: {"m/s2": 1.0, "g0": 9.80665},
        Quantity.ANGULAR_ACCELERATION: {"rad/s2": 1.0, "deg/s2": _DEG},
        Quantity.FORCE: {"N": 1.0, "mN": 1e-3, "kN": 1e3},
        Quantity.ENERGY: {"J": 1.0, "mJ": 1e-3},
        Quantity.POWER: {"W": 1.0, "mW": 1e-3},
        Quantity.PRESSURE: {"Pa": 1.0, "hPa": 1e2, "bar": 1e5},
        Quantity.FREQUENCY: {"Hz": 1.0},
        Quantity.MASS: {"kg": 1.0, "g": 1e-3},
        Quantity.RATIO: {"1": 1.0, "%": 1e-2},
    }.items()
    for name, factor in factors.items()
} | {"K": Unit(Quantity.TEMPERATURE, 1.0, -273.15)}
"""Every unit that a robot file or a mapping of a table may name.

Temperatures are in degC; all other quantities are in SI units.
"""


def find_unit(name: str, *quantities: Quantity, without: Collection[str] = ()) -> Unit:
    """Return the unit with this name; ValueError, with those that there are, if it is of other quantities."""
    fitting = [key for key, one in UNITS.items() if one.quantity in quantities and key not in without]
    if name in fitting:
        return UNITS[name]
    near = get_close_matches(name, fitting, 1)
    hint = f"did you mean {near[0]!r}?" if near else f"write one of {', '.join(fitting)}"
    raise ValueError(f"{name!r} is no unit of {' or '.join(quantities)}; {hint}")


SMALL_UNITS: Final = {"rad": ("mrad", 1e3), "m": ("mm", 1e3), "rad/s": ("mrad/s", 1e3), "m/s": ("mm/s", 1e3)}
"""Units in which errors of a robot are small numbers, and their factors."""


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit, small angles and lengths in thousandths."""
    if not isfinite(value):
        return "not known"
    small, factor = SMALL_UNITS.get(unit, (unit, 1.0))
    return f"{float(f'{value * factor:.3g}'):.7g} {small}"  # without the exponent of 2.04e+03

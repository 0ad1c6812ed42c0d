"""Units of logged values, and their conversion to SI units."""

import math
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
UNITS: Final = {
    "rad": Unit(Quantity.ANGLE, 1.0),
    "mrad": Unit(Quantity.ANGLE, 1e-3),
    "urad": Unit(Quantity.ANGLE, 1e-6),
    "deg": Unit(Quantity.ANGLE, math.pi / 180),
    "turn": Unit(Quantity.ANGLE, 2 * math.pi),
    "count": Unit(Quantity.ANGLE, 2 * math.pi),
    **{name: Unit(Quantity.ANGLE, 1.0 / whole) for name, whole in SHARES.items()},
    "m": Unit(Quantity.LENGTH, 1.0),
    "cm": Unit(Quantity.LENGTH, 1e-2),
    "mm": Unit(Quantity.LENGTH, 1e-3),
    "um": Unit(Quantity.LENGTH, 1e-6),
    "rad/s": Unit(Quantity.SPEED, 1.0),
    "mrad/s": Unit(Quantity.SPEED, 1e-3),
    "deg/s": Unit(Quantity.SPEED, math.pi / 180),
    "rpm": Unit(Quantity.SPEED, 2 * math.pi / 60),
    "turn/s": Unit(Quantity.SPEED, 2 * math.pi),
    "count/s": Unit(Quantity.SPEED, 2 * math.pi),
    "N m": Unit(Quantity.TORQUE, 1.0),
    "mN m": Unit(Quantity.TORQUE, 1e-3),
    "kN m": Unit(Quantity.TORQUE, 1e3),
    "A": Unit(Quantity.CURRENT, 1.0),
    "mA": Unit(Quantity.CURRENT, 1e-3),
    "V": Unit(Quantity.VOLTAGE, 1.0),
    "mV": Unit(Quantity.VOLTAGE, 1e-3),
    "degC": Unit(Quantity.TEMPERATURE, 1.0),
    "K": Unit(Quantity.TEMPERATURE, 1.0, -273.15),
    "s": Unit(Quantity.TIME, 1.0),
    "ms": Unit(Quantity.TIME, 1e-3),
    "us": Unit(Quantity.TIME, 1e-6),
    "ns": Unit(Quantity.TIME, 1e-9),
    "min": Unit(Quantity.TIME, 60.0),
    "h": Unit(Quantity.TIME, 3600.0),
    "flag": Unit(Quantity.FLAG, 1.0),
    "m/s": Unit(Quantity.LINEAR_SPEED, 1.0),
    "mm/s": Unit(Quantity.LINEAR_SPEED, 1e-3),
    "m/s2": Unit(Quantity.ACCELERATION, 1.0),
    "g0": Unit(Quantity.ACCELERATION, 9.80665),
    "rad/s2": Unit(Quantity.ANGULAR_ACCELERATION, 1.0),
    "deg/s2": Unit(Quantity.ANGULAR_ACCELERATION, math.pi / 180),
    "N": Unit(Quantity.FORCE, 1.0),
    "mN": Unit(Quantity.FORCE, 1e-3),
    "kN": Unit(Quantity.FORCE, 1e3),
    "J": Unit(Quantity.ENERGY, 1.0),
    "mJ": Unit(Quantity.ENERGY, 1e-3),
    "W": Unit(Quantity.POWER, 1.0),
    "mW": Unit(Quantity.POWER, 1e-3),
    "Pa": Unit(Quantity.PRESSURE, 1.0),
    "hPa": Unit(Quantity.PRESSURE, 1e2),
    "bar": Unit(Quantity.PRESSURE, 1e5),
    "Hz": Unit(Quantity.FREQUENCY, 1.0),
    "kg": Unit(Quantity.MASS, 1.0),
    "g": Unit(Quantity.MASS, 1e-3),
    "1": Unit(Quantity.RATIO, 1.0),
    "%": Unit(Quantity.RATIO, 1e-2),
}
"""Every unit that a robot file or a mapping of a table may name.

Temperatures are in degC; all other quantities are in SI units.
"""


def find_unit(name: str, *quantities: Quantity) -> Unit:
    """Return the unit with this name; ValueError, with those that there are, if it is of other quantities."""
    unit = UNITS.get(name)
    if unit is not None and unit.quantity in quantities:
        return unit
    fitting = [key for key, one in UNITS.items() if one.quantity in quantities]
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

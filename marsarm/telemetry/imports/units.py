"""Units that a table may use, and their conversion to the units of a log."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi
from typing import Final


@dataclass(frozen=True, slots=True)
class Conversion:
    """Linear conversion: value in the log = factor * value + offset."""

    factor: float = 1.0
    offset: float = 0.0


def _scaled(**factors: float) -> dict[str, Conversion]:
    return {symbol: Conversion(factor) for symbol, factor in factors.items()}


def _per(below: str, factors: dict[str, Conversion]) -> dict[str, Conversion]:
    return {f"{symbol}/{below}": conversion for symbol, conversion in factors.items()}


ANGLES: Final = _scaled(rad=1.0, deg=pi / 180, mrad=1e-3, urad=1e-6, turn=2 * pi)
LENGTHS: Final = _scaled(m=1.0, cm=1e-2, mm=1e-3, um=1e-6)

UNIT_CONVERSIONS: Final[dict[str, dict[str, Conversion]]] = {
    "rad": ANGLES,
    "rad/s": _per("s", ANGLES) | {"rpm": Conversion(2 * pi / 60)},
    "rad/s2": _per("s2", ANGLES),
    "m": LENGTHS,
    "m/s": _per("s", LENGTHS),
    "m/s2": _per("s2", LENGTHS) | {"g0": Conversion(9.80665)},
    "A": _scaled(A=1.0, mA=1e-3, uA=1e-6),
    "N": _scaled(N=1.0, mN=1e-3, kN=1e3),
    "N m": {"N m": Conversion(), "mN m": Conversion(1e-3), "kN m": Conversion(1e3)},
    "degC": {"degC": Conversion(), "K": Conversion(1.0, -273.15)},
    "K": {"K": Conversion(), "degC": Conversion(1.0, 273.15)},
    "s": _scaled(s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0, h=3600.0),
    "J": _scaled(J=1.0, mJ=1e-3, kJ=1e3),
    "V": _scaled(V=1.0, mV=1e-3),
    "W": _scaled(W=1.0, mW=1e-3, kW=1e3),
    "Pa": _scaled(Pa=1.0, hPa=1e2, kPa=1e3, MPa=1e6, bar=1e5),
    "Hz": _scaled(Hz=1.0, kHz=1e3),
    "kg": _scaled(kg=1.0, g=1e-3),
    "count": _scaled(count=1.0),
    "cycle": _scaled(cycle=1.0),
    "bool": _scaled(bool=1.0),
    "1": {"1": Conversion(), "%": Conversion(1e-2)},
}
"""Conversions by the unit in the log, then by the unit in the table."""


def known_units() -> Iterable[str]:
    """Return every unit that a mapping may name."""
    return dict.fromkeys(symbol for symbols in UNIT_CONVERSIONS.values() for symbol in symbols)

"""Errors of a shown angle that repeat with the turn of a joint: encoder eccentricity, teeth of a gear."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, Family, Size

NEWTON_STEPS: Final = 8
"""Newton's method doubles its digits in each step; errors of a few milliradians need three."""
STEEPEST: Final = 0.5
"""Largest slope of one sine or cosine: with both, the shown angle still grows with the true one."""


@dataclass(frozen=True, slots=True)
class PeriodicError(Effect):
    """Sine and cosine of one order: the order is the number of periods in a turn of the joint."""

    name: ClassVar[str] = "periodic joint error"
    family: ClassVar[Family] = Family.GEOMETRY
    place: str
    order: int
    typical_rad: float

    @property
    def key(self) -> str:
        """Name with the order."""
        return f"{self.place}: {self.name} of order {self.order}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Amplitudes; both may have any sign."""
        bound_rad = STEEPEST / self.order
        return (
            Size("sine_rad", -bound_rad, bound_rad, self.typical_rad),
            Size("cosine_rad", -bound_rad, bound_rad, self.typical_rad),
        )

    def describe(self, size: Array) -> str:
        """Return amplitude and phase."""
        amplitude_mrad, phase_rad = 1e3 * np.hypot(size[0], size[1]), np.arctan2(size[1], size[0])
        return f"{amplitude_mrad:.3g} mrad with {self.order} periods a turn, phase {phase_rad:.2f} rad"

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Add the error."""
        return np.asarray(q_rad + _waves(size, (self.order,), q_rad)[0])

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Subtract the error at the true angle."""
        return _solve(size, (self.order,), shown_rad)


@dataclass(frozen=True, slots=True)
class SmoothPeriodicError(Effect):
    """Periodic error of all orders up to a highest one, expected to be smooth.

    The prior of order k has the width sigma / k. An order that the data do not show stays near 0, so the
    effective number of sizes is far below twice the highest order. It is for linear residuals, of geometry or
    a second encoder: in a forward model each size costs a simulation.
    """

    name: ClassVar[str] = "periodic joint error of many orders"
    family: ClassVar[Family] = Family.GEOMETRY
    place: str
    sigma_rad: float
    highest: int = 48
    """All orders up to about 32 are needed for a UR10, and 48 are better for one of two series."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Sine and cosine of each order."""
        return tuple(
            Size(
                f"{wave}_{order}_rad",
                -STEEPEST / order,
                STEEPEST / order,
                self.sigma_rad / order,
                self.sigma_rad / order,
            )
            for order in range(1, self.highest + 1)
            for wave in ("sine", "cosine")
        )

    def describe(self, size: Array) -> str:
        """Return the root mean square, and the strongest order."""
        amplitude_rad = np.hypot(size[::2], size[1::2])
        strongest = int(np.argmax(amplitude_rad))
        return (
            f"{1e3 * np.sqrt(np.sum(np.square(size)) / 2):.3g} mrad RMS, "
            f"most of it {1e3 * amplitude_rad[strongest]:.3g} mrad with {strongest + 1} periods a turn"
        )

    def encode(self, size: Array, q_rad: Array) -> Array:
        """Add the error."""
        return np.asarray(q_rad + _waves(size, range(1, self.highest + 1), q_rad)[0])

    def decode(self, size: Array, shown_rad: Array) -> Array:
        """Subtract the error at the true angle."""
        return _solve(size, range(1, self.highest + 1), shown_rad)


def _waves(size: Array, orders: Sequence[int], q_rad: Array) -> tuple[Array, Array]:
    """Return error and slope, (n_sims, n) each, of sines and cosines in turn, (n_sims, 2 n_orders)."""
    error, slope = np.zeros_like(q_rad), np.zeros_like(q_rad)
    for k, order in enumerate(orders):
        sine, cosine = size[:, [2 * k]], size[:, [2 * k + 1]]
        s, c = np.sin(order * q_rad), np.cos(order * q_rad)
        error += sine * s + cosine * c
        slope += order * (sine * c - cosine * s)
    return error, slope


def _solve(size: Array, orders: Sequence[int], shown_rad: Array) -> Array:
    """Return the angle that is shown so, by Newton's method; at size 0 the first step is exact."""
    q_rad = shown_rad.copy()
    for _ in range(NEWTON_STEPS):
        error, slope = _waves(size, orders, q_rad)
        # orders together may be steeper than 1 in a wild guess of a fit: the step stays finite
        q_rad = q_rad - (q_rad + error - shown_rad) / np.maximum(1 + slope, 0.25)
    return q_rad

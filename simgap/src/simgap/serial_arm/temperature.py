"""Test of the air temperature: it must predict better than placebo curves."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.serial_arm.arm import GEOMETRY_NAMES
from simgap.serial_arm.calibrate import SerialCalibration
from simgap.serial_arm.model import GEOMETRY, serial_model
from simgap.serial_arm.nested_models import CrossValidation, gain_m

SHIFTS: Final = 19
"""Number of placebos that are the temperature of another time.

A random curve beats them and the two other placebos once in 22 cases.
"""
LENGTHS: Final = ("d", "b", "a")
EXPANSION_PER_K: Final = 2.3e-5
"""Thermal expansion of aluminium."""
MOVES_M_PER_K: Final = 1e-4
MOVES_RAD_PER_K: Final = 1e-4
"""Motion of a stand or a tracker, one sigma."""


@dataclass(frozen=True, slots=True)
class TemperatureTest:
    """Cross-validated errors with and without the air temperature."""

    range_K: float
    without_m: float
    with_m: float
    gain_m: float
    """Reduction of the error, mean over blocks of time."""
    gain_sigma_m: float
    placebo: str
    """Placebo curve with the largest gain."""
    placebo_gain_m: float

    @property
    def explains(self) -> bool:
        """Return whether the gain exceeds its standard error and the gain of every placebo."""
        return self.gain_m > self.gain_sigma_m and self.gain_m > self.placebo_gain_m


def temperature_test(found: SerialCalibration, validation: CrossValidation) -> TemperatureTest | None:
    """Cross-validate a model in which base and link lengths follow the air temperature or placebo curves.

    The base shifts and rotates in proportion to the temperature, and all lengths grow together. Any drift in
    time can look like temperature, so clock, reversed and shifted temperatures serve as placebos.

    Returns:
        The test; None if the air temperature is unknown.
    """
    series = found.model.series
    if series.air_C is None:
        return None
    air = series.air_C[found.fit.used]
    columns = _columns(found)
    before = validation.held_out()
    spread = float(np.std(air))
    if spread == 0.0:
        return TemperatureTest(0.0, before.rms_m, before.rms_m, 0.0, 0.0, "none", 0.0)
    after = validation.held_out(columns * (air - air.mean())[:, None, None])
    gain, sigma = gain_m(before, after)
    best, most = "none", -np.inf
    for name, curve in _placebos(air):
        fell, _ = gain_m(before, validation.held_out(columns * curve[:, None, None]))
        if fell > most:
            best, most = name, fell
    return TemperatureTest(float(np.ptp(air)), before.rms_m, after.rms_m, gain, sigma, best, most)


def drift_gain(
    found: SerialCalibration, validation: CrossValidation, curve_K: Array
) -> tuple[float, float, float]:
    """Cross-validate a model in which base and link lengths follow a curve in time.

    Args:
        curve_K: Values at the fitted poses in kelvin, with a mean of 0, shape (n,).

    Returns:
        Mean reduction of the block errors [m], its standard error [m], and the share of variance explained.
    """
    before, after = validation.held_out(), validation.held_out(_columns(found) * curve_K[:, None, None])
    return *gain_m(before, after), 1.0 - (after.rms_m / before.rms_m) ** 2


def _columns(found: SerialCalibration) -> Array:
    """Compute the Jacobian columns of base (six) and arm growth per kelvin, in units of their expected size.

    Returns:
        Columns, shape (n, 6, 7).
    """
    arm = found.arm
    model = serial_model(arm, found.setup, found.model.series.at(found.fit.used), (GEOMETRY,))
    J = model(np.zeros(len(model.parameters))).jacobian
    base = J[:, :, :6] * np.tile([MOVES_RAD_PER_K, MOVES_M_PER_K], 3)
    lengths = np.where([name in LENGTHS for name in GEOMETRY_NAMES], arm.link_geometry, 0.0)
    growth = J[:, :, 12:] @ (EXPANSION_PER_K * lengths.ravel())
    return np.concatenate([base, growth[:, :, None]], axis=2)


def _placebos(air: Array) -> Iterator[tuple[str, Array]]:
    """Generate placebo curves with the same spread as the temperature."""
    mean, spread = air.mean(), air.std()
    clock = np.linspace(-1.0, 1.0, air.size)
    yield "clock", clock / clock.std() * spread
    yield "reversed", air[::-1] - mean
    for k in range(1, SHIFTS + 1):
        yield f"shifted by {k / (SHIFTS + 1):.0%}", np.roll(air, k * air.size // (SHIFTS + 1)) - mean

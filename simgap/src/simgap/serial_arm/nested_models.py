"""Models of an arm, term by term, cross-validated; and the test of the air temperature against placebos."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from simgap.arrays import Array, Flags, Integers
from simgap.common.progress import Progress
from simgap.serial_arm import calibrate
from simgap.serial_arm.chain import PoseSeries
from simgap.serial_arm.fit import BlockEquations, Fit
from simgap.serial_arm.model import GEOMETRY, GEOMETRY_NAMES, SerialArm, TrackerSetup, serial_model

BLOCKS: Final = 5
"""Number of blocks of time in the cross-validation."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutErrors:
    """Squared position errors of poses, each predicted from the other blocks."""

    square_m2: Array
    """Squared errors, shape (n,)."""
    block: Integers
    """Index of the block of each pose, shape (n,)."""

    @property
    def rms_m(self) -> float:
        """Compute the root mean square over all poses."""
        return float(np.sqrt(np.mean(self.square_m2)))

    @property
    def rms_by_block_m(self) -> Array:
        """Compute the root mean square of each block, shape (b,)."""
        return np.sqrt([np.mean(self.square_m2[self.block == k]) for k in range(BLOCKS)])


def gain_m(before: HeldOutErrors, after: HeldOutErrors) -> tuple[float, float]:
    """Compute the reduction of the error, mean over the blocks, and its standard error."""
    reduction = before.rms_by_block_m - after.rms_by_block_m
    return float(np.mean(reduction)), float(np.std(reduction, ddof=1) / np.sqrt(reduction.size))


class CrossValidation(BlockEquations):
    """Errors of each block of time by a fit to the others."""

    def __init__(self, fitted: Fit, position_sigma_m: float):
        super().__init__(fitted, BLOCKS)
        self._sigma_m = position_sigma_m
        self._factor = [cho_factor(self.H.sum(axis=0) - own + self.penalty) for own in self.H]

    def held_out(self, more: Array | None = None) -> HeldOutErrors:
        """Predict each block from the others.

        Args:
            more: Additional whitened columns of the Jacobian, in units of prior sigmas, shape (n, 6, m).
        """
        square = np.empty(self.r.shape[0])
        for k in range(BLOCKS):
            in_block = self.block == k
            residual = self.r[in_block] + self._predicted(k, in_block, more)
            square[in_block] = np.sum(residual[:, 3:] ** 2, axis=1) * self._sigma_m**2
        return HeldOutErrors(square, self.block)

    def _predicted(self, k: int, in_block: Flags, more: Array | None) -> Array:
        """Compute the change of a block's residuals if only the other blocks are fitted."""
        factor, g = self._factor[k], self.pull + self.g.sum(axis=0) - self.g[k]
        if more is None:
            step = -cho_solve(factor, g)
            return np.asarray(self.J[in_block] @ step)
        others = ~in_block
        E = more[others].reshape(-1, more.shape[2])
        B = self.J[others].reshape(E.shape[0], -1).T @ E
        solved = cho_solve(factor, np.column_stack([B, g]))
        corner = E.T @ E + np.eye(E.shape[1]) - B.T @ solved[:, :-1]
        extra = -np.linalg.solve(corner, E.T @ self.r[others].ravel() - B.T @ solved[:, -1])
        step = -solved[:, -1] - solved[:, :-1] @ extra
        return np.asarray(self.J[in_block] @ step + more[in_block] @ extra)


@dataclass(frozen=True, slots=True, eq=False)
class NestedModel:
    """Fitted model with the terms up to this step."""

    terms: tuple[str, ...]
    found: calibrate.SerialCalibration
    validation: CrossValidation
    held_out: HeldOutErrors
    """Cross-validated errors within the fitted poses."""
    gain_m: float
    """Reduction of the cross-validated error from the step before, mean over the blocks of time."""
    gain_sigma_m: float
    fitted: calibrate.PoseErrors
    fresh: calibrate.PoseErrors
    """Errors of poses that were not fitted."""

    @property
    def is_significant(self) -> bool:
        """Return whether the error fell by more than a standard error."""
        return self.gain_m > self.gain_sigma_m


def fit_nested_models(
    arm: SerialArm,
    setup: TrackerSetup,
    part: PoseSeries,
    fresh: PoseSeries,
    steps: Sequence[tuple[str, ...]],
    progress: Progress,
) -> tuple[NestedModel, ...]:
    """Fit each set of terms to one part of a series, and compare it with the other part.

    Outliers of the largest model are left out of all fits; RobotError if they are too many.
    """
    progress(0, len(steps), "fitting")
    whole = calibrate.calibrate_series(arm, setup, part, steps[-1])
    done: list[NestedModel] = []
    for terms in steps:
        progress(len(done) + 1, len(steps) + 1, "judging")
        is_whole = terms == steps[-1]
        found = whole if is_whole else calibrate.fit_poses(arm, setup, part, terms, whole.fit.used)
        validation = CrossValidation(found.fit, arm.repeatability.position_m)
        held_out = validation.held_out()
        gain = gain_m(done[-1].held_out, held_out) if done else (np.inf, 0.0)
        errors = [calibrate.pose_errors(found.arm, found.setup, one) for one in (part, fresh)]
        done.append(NestedModel(terms, found, validation, held_out, *gain, *errors))
    return tuple(done)


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


def temperature_test(
    found: calibrate.SerialCalibration, validation: CrossValidation
) -> TemperatureTest | None:
    """Cross-validate a model in which base and link lengths follow the air temperature or placebo curves.

    The base shifts and rotates in proportion to the temperature, and all lengths grow together. Any drift in
    time can look like temperature, so clock, reversed and shifted temperatures serve as placebos. None if the
    temperature is unknown.
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
    found: calibrate.SerialCalibration, validation: CrossValidation, curve_K: Array
) -> tuple[float, float, float]:
    """Cross-validate a model in which base and link lengths follow a curve in time.

    Args:
        curve_K: Values at the fitted poses in kelvin, with a mean of 0, shape (n,).

    Returns:
        Mean reduction of the block errors [m], its standard error [m], and the share of variance explained.
    """
    before, after = validation.held_out(), validation.held_out(_columns(found) * curve_K[:, None, None])
    return *gain_m(before, after), 1.0 - (after.rms_m / before.rms_m) ** 2


def _columns(found: calibrate.SerialCalibration) -> Array:
    """Compute Jacobian columns of base (six) and arm growth per kelvin, (n, 6, 7), in expected sizes."""
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

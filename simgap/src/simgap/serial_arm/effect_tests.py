"""Tests of each effect of each joint, with all others in the model: none of them can stand in for it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from simgap.arrays import Array, Flags
from simgap.serial_arm.calibrate import SerialCalibration
from simgap.serial_arm.effects import (
    DirectionHysteresis,
    JointCompliance,
    PeriodicJointError,
    TrackerEffect,
)
from simgap.serial_arm.elimination import BLOCKS, Eliminated, Elimination, jackknife_sigma
from simgap.serial_arm.fit import Fit
from simgap.serial_arm.model import NON_PERIODIC
from simgap.serial_arm.nested_models import NestedModel

FALSE_ALARM: Final = 0.05
"""Probability of naming any effect on an arm without one."""
COVERAGE: Final = 0.90
"""Coverage of the intervals."""


@dataclass(frozen=True, slots=True)
class EffectTest:
    """Test of one effect among all others."""

    effect: TrackerEffect
    half_width: float
    """Half of the interval of its size, in its unit."""
    gain: float
    """Share of the error of left-out blocks that comes back without it."""
    problem: str
    """Reason not to name it; empty: it is named."""


def list_effects(found: SerialCalibration) -> list[TrackerEffect]:
    """List the effects of all joints that compete, from the base outward."""
    effects: list[TrackerEffect] = []
    for one in found.model.arm.links:
        effects += [PeriodicJointError(one.name, found.model.orders), JointCompliance(one.name)]
        effects += [DirectionHysteresis(one.name)]
    return effects


def flag_parameters(fit: Fit, effects: list[TrackerEffect]) -> Flags:
    """Flag the parameters of some effects.

    Args:
        fit: Fit with the parameters.

    Returns:
        Flags, shape (p,).
    """
    wanted = {f"{effect.place}.{number}" for effect in effects for number in effect.numbers}
    return np.array([one.name in wanted for one in fit.parameters])


def judge_effects(
    models: tuple[NestedModel, ...], elimination: Elimination, effects: list[TrackerEffect]
) -> list[EffectTest]:
    """Test effects of joints.

    An effect is named if three things hold. Its term lowers the error of left-out blocks. Its size is not 0,
    with FALSE_ALARM over all effects together. Without it, left-out blocks are predicted worse.

    Args:
        models: Nested models, one for each term.
        elimination: Fits of the last model without some parameters.
        effects: Effects to test.

    Returns:
        A test for each effect.
    """
    found = models[-1].found
    significant = {model.terms[-1]: model.is_significant for model in models[1:]}
    whole = elimination.without(flag_parameters(found.fit, []))
    return [
        _test(found, elimination, whole, effect, FALSE_ALARM / len(effects), significant[effect.term])
        for effect in effects
    ]


def _test(
    found: SerialCalibration,
    elimination: Elimination,
    whole: Eliminated,
    effect: TrackerEffect,
    false_alarm: float,
    is_significant: bool,
) -> EffectTest:
    fit = found.fit
    own = flag_parameters(fit, [effect])
    without = elimination.without(own)
    gain = 1.0 - float(np.mean(whole.block_error) / np.mean(without.block_error))
    covariance = widened_covariance(fit)[np.ix_(own, own)]
    values = whole.values[own]
    distance = float(values @ np.linalg.solve(covariance, values))
    size, gradient, by_block = effect_size(found, effect, whole)
    sigma = float(np.sqrt(gradient @ covariance @ gradient))
    scatter = float(jackknife_sigma(by_block[:, None])[0])
    half_width = max(
        norm.isf((1 - COVERAGE) / 2) * sigma, student.isf((1 - COVERAGE) / 2, BLOCKS - 1) * scatter
    )
    is_zero = distance < chi2.isf(false_alarm, values.size)
    is_zero |= values.size == 1 and abs(size) < student.isf(false_alarm / 2, BLOCKS - 1) * scatter
    problem = ""
    if not is_significant:
        problem = f"{effect.term} at all joints together does not lower the error of left-out blocks"
    elif is_zero:
        problem = "its size is not different from 0"
    elif isinstance(effect, JointCompliance) and size < 0:
        problem = "it is negative, which no joint is"
    elif gain <= 0:
        problem = "left-out blocks are predicted as well without it"
    return EffectTest(effect, half_width, gain, problem)


def widened_covariance(fit: Fit) -> Array:
    """Compute the covariance of a fit, widened where the noise is larger than stated.

    Returns:
        Covariance in the units of the parameters, shape (p, p).
    """
    return fit.covariance * max(1.0, fit.sigma0) ** 2


def effect_size(
    found: SerialCalibration, effect: TrackerEffect, fits: Eliminated
) -> tuple[float, Array, Array]:
    """Compute the size of an effect; that of a periodic error is its root mean square at the fitted poses.

    Args:
        found: Calibration with all effects.
        effect: The effect, with k parameters.
        fits: Values of all parameters.

    Returns:
        The size in its unit, its gradient, shape (k,), and its values without each block, shape (b,).
    """
    own = flag_parameters(found.fit, [effect])
    values, by_block = fits.values[own], fits.by_block[:, own]
    if not isinstance(effect, PeriodicJointError):
        return float(values[0]), np.ones(1), by_block[:, 0]
    waves = wave_features(found, effect)
    square = waves.T @ waves / waves.shape[0]
    size = float(np.sqrt(values @ square @ values))
    gradient: Array = square @ values / max(size, np.finfo(float).tiny)
    return size, gradient, np.sqrt(np.einsum("bi,ij,bj->b", by_block, square, by_block))


def wave_features(found: SerialCalibration, effect: PeriodicJointError) -> Array:
    """Select the features of the periodic error of a joint.

    Args:
        effect: Periodic error of the joint, with k parameters.

    Returns:
        Cosines and sines at the fitted poses, unitless, shape (n, k).
    """
    joint = [one.name for one in found.model.arm.links].index(effect.place)
    waves: Array = found.model.features[joint][found.fit.used, len(NON_PERIODIC) :]
    return waves

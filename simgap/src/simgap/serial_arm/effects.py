"""Effects in the joints of a serial arm: fits without some of them, and whether each is named."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from simgap.arrays import Array, Flags
from simgap.effects.effect import Effect, Family, Size
from simgap.serial_arm.calibrate import SerialCalibration
from simgap.serial_arm.fit import BlockEquations, Fit
from simgap.serial_arm.model import (
    COMPLIANCE,
    GEOMETRY,
    GEOMETRY_NAMES,
    HYSTERESIS,
    NON_PERIODIC,
    PERIODIC,
    Link,
    SerialArm,
    coefficient_names,
)
from simgap.serial_arm.nested_models import LENGTHS, NestedModel

MAX_SIZE: Final = 1.0
"""Largest size in radians, metres or rad/(N m): that of an arm file."""


class TrackerEffect(Effect):
    """Effect of one link; its sizes are differences from the arm file, which are 0 where it is absent."""

    term: ClassVar[str]
    """Term of the calibration that fits it."""

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of its parameters in the calibration, without that of the link; here its term."""
        return (self.term,)

    @property
    def sizes(self) -> tuple[Size, ...]:
        """One for each parameter; compliance has one direction."""
        low = 0.0 if self.term == COMPLIANCE else -MAX_SIZE
        return tuple(Size(with_unit(one), low, MAX_SIZE, TYPICAL[self.term]) for one in self.numbers)


@dataclass(frozen=True, slots=True)
class LinkGeometry(TrackerEffect):
    """Errors of the six parameters of a link."""

    name: ClassVar[str] = "link geometry"
    family: ClassVar[Family] = Family.GEOMETRY
    term: ClassVar[str] = GEOMETRY
    place: str

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names in the order of the arm file."""
        return GEOMETRY_NAMES


@dataclass(frozen=True, slots=True)
class TrackerCompliance(TrackerEffect):
    """Rotation of a joint in proportion to its gravity torque."""

    name: ClassVar[str] = "joint compliance"
    family: ClassVar[Family] = Family.TRANSMISSION
    term: ClassVar[str] = COMPLIANCE
    place: str


@dataclass(frozen=True, slots=True)
class DirectionHysteresis(TrackerEffect):
    """Joint error that depends on the direction from which the joint came."""

    name: ClassVar[str] = "direction hysteresis"
    family: ClassVar[Family] = Family.TRANSMISSION
    term: ClassVar[str] = HYSTERESIS
    place: str


@dataclass(frozen=True, slots=True)
class PeriodicJointError(TrackerEffect):
    """Joint error that repeats with the turn of the joint, of all orders up to a highest one."""

    name: ClassVar[str] = "periodic joint error"
    family: ClassVar[Family] = Family.GEOMETRY
    term: ClassVar[str] = PERIODIC
    place: str
    orders: int

    @property
    def numbers(self) -> tuple[str, ...]:
        """Cosines, then sines."""
        return tuple(coefficient_names(self.orders)[len(NON_PERIODIC) :])


TYPICAL: Final = {GEOMETRY: 1e-3, COMPLIANCE: 1e-5, HYSTERESIS: 1e-4, PERIODIC: 1e-4}
"""Sizes that an industrial arm may have."""


def with_unit(number: str) -> str:
    """Return the name of a parameter with its unit, as in the arm file."""
    if number == COMPLIANCE:
        return f"{number}_rad_per_Nm"
    return f"{number}_{'m' if number in LENGTHS else 'rad'}"


def patch_arm(arm: SerialArm, effects: Sequence[Effect], sizes: Sequence[Sequence[float]]) -> SerialArm:
    """Add effects to an arm."""
    links = {one.name: one for one in arm.links}
    for effect, size in zip(effects, sizes, strict=True):
        if isinstance(effect, TrackerEffect):
            links[effect.place] = _patch_link(links[effect.place], effect, size)
    return replace(arm, links=tuple(links.values()))


def _patch_link(link: Link, effect: TrackerEffect, size: Sequence[float]) -> Link:
    if isinstance(effect, PeriodicJointError):
        orders = max(effect.orders, len(link.cos_rad or ()))
        waves = link.periodic_rad(orders)
        waves[:, : effect.orders] += np.reshape(size, (2, effect.orders))
        return replace(link, cos_rad=tuple(waves[0].tolist()), sin_rad=tuple(waves[1].tolist()))
    names = [with_unit(number) for number in effect.numbers]
    added = {name: getattr(link, name) + float(value) for name, value in zip(names, size, strict=True)}
    return replace(link, **added)


BLOCKS: Final = 10
"""Number of blocks of time: a standard error of ten values is known within a quarter."""


@dataclass(frozen=True, slots=True, eq=False)
class Eliminated:
    """Values with some parameters at zero."""

    values: Array
    """Values from all poses in the units of the parameters, shape (p,)."""
    by_block: Array
    """Values from the poses outside of each block, shape (b, p)."""
    block_error: Array
    """Root mean square whitened residual of each block, predicted from the others, shape (b,)."""


class Elimination(BlockEquations):
    """Fits to all poses, and to those outside of each block of time, without any part of the parameters."""

    def __init__(self, fitted: Fit):
        super().__init__(fitted, BLOCKS)
        H, g = self.H.sum(axis=0) + self.penalty, self.g.sum(axis=0) + self.pull
        self._inverse = [np.linalg.inv(H - part) for part in (np.zeros_like(H), *self.H)]
        self._gradient = [g - part for part in (np.zeros_like(g), *self.g)]

    def without(self, removed: Flags) -> Eliminated:
        """Fit with some parameters at zero.

        Args:
            removed: Boolean flags of these parameters, shape (p,).
        """
        steps = [self._step(H, g, removed) for H, g in zip(self._inverse, self._gradient, strict=True)]
        error = np.empty(BLOCKS)
        for k in range(BLOCKS):
            here = self.block == k
            error[k] = np.sqrt(np.mean((self.r[here] + self.J[here] @ steps[k + 1]) ** 2))
        values = self.fit.values + np.array(steps) * self.scale
        values[:, removed] = 0.0
        return Eliminated(values[0], values[1:], error)

    def _step(self, inverse: Array, gradient: Array, removed: Flags) -> Array:
        """Solve the normal equations under the constraint that the values of some parameters become zero."""
        step = -inverse @ gradient
        if removed.any():
            excess = step[removed] + (self.fit.values / self.scale)[removed]
            step = step - inverse[:, removed] @ np.linalg.solve(inverse[np.ix_(removed, removed)], excess)
        return step


def jackknife_sigma(by_block: Array) -> Array:
    """Compute standard errors, shape (k,), of numbers from their values without each block.

    Blocks differ by all that the model lacks, so these know more than the covariance of a fit.

    Args:
        by_block: Numbers in any unit, shape (b, k).
    """
    b = by_block.shape[0]
    return np.asarray(np.sqrt((b - 1) * np.var(by_block, axis=0)))


FALSE_ALARM: Final = 0.05
"""Probability of naming any effect on an arm without one."""
COVERAGE: Final = 0.90


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
    """List the effects of all joints whose terms were fitted, from the base outward."""
    effects: list[TrackerEffect] = []
    for one in found.model.arm.links:
        effects += [PeriodicJointError(one.name, found.model.orders), TrackerCompliance(one.name)]
        effects += [DirectionHysteresis(one.name)]
    return [effect for effect in effects if effect.term in found.model.terms]


def flag_parameters(fit: Fit, effects: list[TrackerEffect]) -> Flags:
    """Flag the parameters of some effects, shape (p,)."""
    wanted = {f"{effect.place}.{number}" for effect in effects for number in effect.numbers}
    return np.array([one.name in wanted for one in fit.parameters])


def judge_effects(
    models: tuple[NestedModel, ...], elimination: Elimination, effects: list[TrackerEffect]
) -> list[EffectTest]:
    """Test effects of joints.

    An effect is named if three things hold. Its term lowers the error of left-out blocks. Its size is not 0,
    with FALSE_ALARM over all effects together. Without it, left-out blocks are predicted worse.
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
    elif isinstance(effect, TrackerCompliance) and size < 0:
        problem = "it is negative, which no joint is"
    elif gain <= 0:
        problem = "left-out blocks are predicted as well without it"
    return EffectTest(effect, half_width, gain, problem)


def widened_covariance(fit: Fit) -> Array:
    """Compute the covariance of a fit, shape (p, p), widened where the noise is larger than stated."""
    return fit.covariance * max(1.0, fit.sigma0) ** 2


def effect_size(
    found: SerialCalibration, effect: TrackerEffect, fits: Eliminated
) -> tuple[float, Array, Array]:
    """Compute the size of an effect; that of a periodic error is its root mean square at the fitted poses.

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
    """Select the features of a joint's periodic error at the fitted poses, unitless, shape (n, k)."""
    joint = [one.name for one in found.model.arm.links].index(effect.place)
    return np.asarray(found.model.features[joint][found.fit.used, len(NON_PERIODIC) :])

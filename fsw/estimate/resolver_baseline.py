"""Place of an output inside its backlash by its resolver, where friction and load do not tell it.

Where both flanks are within the bounds of the gear angle, the resolver on the output tells them apart. Its
bias is not known well enough at every angle, but it changes slowly: its error is compared with that where
the side was last known.
"""

from math import sqrt
from typing import Final

import numpy as np

from fsw.config import CYCLE_HZ, Config
from fsw.dictionary.types import cycle_record
from fsw.estimate.gear import LEAST, LIKELY, MOST
from fsw.kinematics.transforms import Array, Flags

RESOLVER_FILTER_S: Final = 0.25
"""Time constant of the smoothing of the resolver error."""
RESOLVER_GAIN: Final = np.array(1.0 / (RESOLVER_FILTER_S * CYCLE_HZ))
NOISE_SIGMAS: Final = 5.0
"""Bound of noise in standard deviations, which one of 1.7 million readings passes."""


@cycle_record
class ResolverBaseline:
    """Resolver errors where the sides were known, and what they have told since."""

    known_rad: Array
    """Resolver error where the side was last known at the end of a move, (5,)."""
    known_output_rad: Array
    """Output angle there, (5,)."""
    braked_rad: Array
    """Smoothed resolver error when the brakes were last put on, (5,)."""
    located_motor_rad: Array
    """Motor angle at which the resolver has located the output; infinite where it has not, (5,)."""


def new_baseline(config: Config) -> ResolverBaseline:
    """Build the baseline at boot: the biases were learned at the hardstops."""
    zeros = np.zeros_like(config.hardstop_rad)
    return ResolverBaseline(zeros, config.hardstop_rad, zeros, np.full_like(zeros, np.inf))


def bound_drift(config: Config, baseline: ResolverBaseline, output_rad: Array) -> Array:
    """Compute how far a resolver error may have changed, (5,) [rad], since the side was known.

    Both errors are means of the readings on the brakes. The bias of a resolver is within the bound of its
    monitor; with one period a turn it changes by no more than that in a radian.
    """
    monitors = config.params.monitors
    mean_rad = monitors.resolver_noise_rad / sqrt(_braked_cycles(config))
    turn_rad = np.abs(output_rad - baseline.known_output_rad)
    bound: Array = NOISE_SIGMAS * sqrt(2.0) * mean_rad + monitors.resolver_error_rad * turn_rad
    return bound


def error_on_brakes(config: Config, baseline: ResolverBaseline, smoothed_rad: Array) -> Array:
    """Compute the mean resolver error (5,) [rad] since the brakes were put on.

    The smoothed error is partly from before, when outputs may still have crossed their backlash.

    Args:
        smoothed_rad: Smoothed resolver error where a move ends, shape (5,).
    """
    left = float(1.0 - RESOLVER_GAIN) ** _braked_cycles(config)
    error: Array = (smoothed_rad - left * baseline.braked_rad) / (1.0 - left)
    return error


def narrow_gear(gear_rad: Array, located: Flags, error_rad: Array, bound_rad: Array) -> Array:
    """Return gear angles (5, 3) [rad], some of them as the resolvers read them.

    Args:
        located: Outputs that their resolvers locate, as flags, shape (5,).
        error_rad: Resolver less likely output, shape (5,).
        bound_rad: Largest error of what the resolvers read, shape (5,).
    """
    least, likely, most = gear_rad.T
    found = np.clip(likely + error_rad, least, most)
    narrowed = np.empty_like(gear_rad)
    narrowed[:, LEAST] = np.maximum(least, found - bound_rad)
    narrowed[:, LIKELY] = found
    narrowed[:, MOST] = np.minimum(most, found + bound_rad)
    return np.where(located[:, None], narrowed, gear_rad)


def _braked_cycles(config: Config) -> int:
    """Return the number of readings from the cycle in which brakes are put on to the end of the move."""
    return config.brake_ticks + 1

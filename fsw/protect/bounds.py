"""Bounds that protection applies, computed once from the parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Final

import numpy as np

from fsw.dictionary.params import MonitorParams, Params
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import Array

LOAD_ERROR_FACTOR: Final = 5.0
"""On an approach, a gear counts if its torque exceeds this many times the error of its modelled load."""


FAST_GAIN: Final = 0.125
"""Smoothing per cycle of the wind-up in a free move: a force rises by newtons a cycle, as large as the noise."""
SIGMAS: Final = 6.0
"""Noise passes this many sigmas once in 1e9 independent readings."""
LEAST_READINGS: Final = 16
"""Readings from which a mean without a force is known: its noise is then that of the fast mean."""
MOST_READINGS: Final = 256
"""Readings in that mean, 4 s: the force of a slow straight move reaches its bound in 1 s."""


@dataclass(frozen=True, slots=True, eq=False)
class ProtectionBounds:
    """Bounds; joint arrays in the order of Joint, angles on the output side."""

    monitors: MonitorParams
    arm: Arm
    switch_names: tuple[str, ...]
    """Contact switches, in the order of the sensor word."""
    tool_switches: Mapping[str, tuple[int, ...]]
    """Indices of the contact switches of each tool."""
    press_step_N: float
    """A tool that presses with more must have a switch closed."""
    press_error_share: float
    """Error of the believed force of a press, as a share of it."""
    lowest_rad: Array
    """Motor angles that are never to be passed: the soft limits and their margin, (5,)."""
    highest_rad: Array
    lowest_homing_rad: Array
    """Lowest motor angles in homing, a row for each joint that is being homed, (5, 5)."""
    setpoint_step_rad: Array
    """Largest change of a set-point in a cycle, (5,)."""
    over_current_A: Array
    """Current that is nearly all that a motor may draw, (5,)."""
    approach_wind_up_rad: Array
    """Wind-up beyond the backlash from which a gear counts on an approach, (5,)."""
    free_noise_rad: tuple[float, ...]
    """Wind-up in a free move that noise explains, by the number of readings in the slow mean."""
    free_step_rad: tuple[float, ...]
    """Change of the wind-up in a cycle that noise and speed explain, (5,)."""
    monitored_lowest: tuple[float, ...]
    """Lower bounds of the values that `motors.exceed_any_bound` compares, in its order, (25,)."""
    monitored_highest: tuple[float, ...]
    """Upper bounds of the same values, (25,)."""


def compute_bounds(params: Params, arm: Arm, cycle_s: float) -> ProtectionBounds:
    """Compute the bounds of protection.

    Args:
        params: Parameters of flight software.
        arm: Arm of these parameters.
        cycle_s: Duration of a control cycle.

    Returns:
        The bounds.
    """
    joints, monitors = params.joints.in_order(), params.monitors
    lowest = np.array([j.soft_min_rad - monitors.soft_limit_margin_rad for j in joints])
    highest = np.array([j.soft_max_rad + monitors.soft_limit_margin_rad for j in joints])
    lowest_homing = np.tile(lowest, (len(joints), 1))
    np.fill_diagonal(lowest_homing, [j.hardstop_rad - 2 * params.hardstop.window_rad for j in joints])
    lag = np.full(len(joints), min(monitors.stall_error_rad, monitors.following_error_rad))
    over_current = monitors.over_current_fraction * np.array([j.current_limit_A for j in joints])
    coldest, hottest = np.full_like(lag, monitors.winding_min_C), np.full_like(lag, monitors.winding_max_C)
    resolver_error = np.full_like(lag, monitors.resolver_error_rad)
    load_error = np.array([j.load_error_Nm for j in joints])
    return ProtectionBounds(
        monitors=monitors,
        arm=arm,
        switch_names=tuple(switch.name for switch in params.switches),
        tool_switches=params.tool_switches,
        press_step_N=params.preload.step_N,
        press_error_share=params.preload.error_share,
        lowest_rad=lowest,
        highest_rad=highest,
        lowest_homing_rad=lowest_homing,
        setpoint_step_rad=np.array([monitors.setpoint_step_factor * cycle_s * j.speed_rad_s for j in joints]),
        over_current_A=over_current,
        approach_wind_up_rad=LOAD_ERROR_FACTOR * load_error / arm.gear_stiffness_Nm_rad,
        free_noise_rad=_compute_free_noise(monitors.resolver_noise_rad),
        free_step_rad=tuple(
            cycle_s * j.speed_rad_s + SIGMAS * sqrt(2.0) * monitors.resolver_noise_rad for j in joints
        ),
        monitored_lowest=tuple(
            np.concatenate((lowest, -lag, -over_current, coldest, -resolver_error)).tolist()
        ),
        monitored_highest=tuple(
            np.concatenate((highest, lag, over_current, hottest, resolver_error)).tolist()
        ),
    )


def _compute_free_noise(noise_rad: float) -> tuple[float, ...]:
    """Compute the wind-up that noise explains, by the number of readings in the slow mean."""
    fast = FAST_GAIN / (2.0 - FAST_GAIN)
    return tuple(SIGMAS * noise_rad * sqrt(fast + 1.0 / max(n, 1)) for n in range(MOST_READINGS + 1))

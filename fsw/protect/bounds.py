"""Bounds that protection applies, computed once from the parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, sqrt
from typing import Final

import numpy as np

from fsw.dictionary.params import MonitorParams, Params
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import Array

LOAD_ERROR_FACTOR: Final = 5.0
"""On an approach, a gear counts if its torque exceeds this many times the error of its modelled load."""


CURRENT_GAIN: Final = 0.25
"""Smoothing per cycle of a current: a stiff obstacle adds a sigma of noise every cycle or two."""
WIND_UP_GAIN: Final = 1 / 16
"""Smoothing per cycle of the resolver error, as the estimate of the joints gives it."""
UPDATE_CYCLES: Final = 8
"""Cycles from one update of the slow means to the next; fast means of currents are then independent."""
CURRENT_UPDATES: Final = 8
"""Updates in the slow mean of a current, 1 s: longer than a contact takes to be found."""
WIND_UP_UPDATES: Final = 32
"""Updates in the slow mean of a wind-up, 4 s, sixteen times as long as its fast mean."""
SIGMAS: Final = 6.0
"""Noise passes this many sigmas once in 1e9 readings."""


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
    setpoint_step_rad: tuple[float, ...]
    """Largest change of a set-point in a cycle, (5,)."""
    over_current_A: Array
    """Current that is nearly all that a motor may draw, (5,)."""
    approach_wind_up_rad: Array
    """Wind-up beyond the backlash from which a gear counts on an approach, (5,)."""
    stiffness_A_rad: tuple[float, ...]
    """Stiffness of the gears over the torque constants, (5,)."""
    load_error_A: tuple[float, ...]
    """Errors of the modelled loads over the torque constants, (5,)."""
    damping_As_rad: tuple[float, ...]
    """Viscous friction in the cold over the torque constants, (5,)."""
    steady_A: tuple[float, ...]
    """Change of the current at a steady speed that is no contact, (5,).

    It is what the jerk of a move adds to viscous friction between two updates; vibration draws as much.
    """
    updates_Hz: float
    """Updates of the slow means a second."""
    turning_rad_s: tuple[float, ...]
    """Rates of one encoder count a cycle, (5,)."""
    reading_step: tuple[float, ...]
    """Changes in a cycle that noise, speed and stiffness explain: of the currents, then of resolver less
    motor angles, (10,)."""
    current_sigma_A: tuple[float, ...]
    """Noise of a fast mean current less its slow mean, by the number of updates of the latter."""
    wind_up_sigma_rad: tuple[float, ...]
    """Noise of a fast mean wind-up less its slow mean, by the number of updates of the latter."""
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
    constant = np.array([j.torque_constant_Nm_A for j in joints])
    speed = np.array([j.speed_rad_s for j in joints])
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
        setpoint_step_rad=tuple(monitors.setpoint_step_factor * cycle_s * j.speed_rad_s for j in joints),
        over_current_A=over_current,
        approach_wind_up_rad=LOAD_ERROR_FACTOR * load_error / arm.gear_stiffness_Nm_rad,
        stiffness_A_rad=tuple((arm.gear_stiffness_Nm_rad / constant).tolist()),
        load_error_A=tuple((load_error / constant).tolist()),
        damping_As_rad=tuple(j.damping_Nms_rad / j.torque_constant_Nm_A for j in joints),
        steady_A=tuple(
            j.damping_Nms_rad * j.jerk_rad_s3 * (UPDATE_CYCLES * cycle_s) ** 2 / j.torque_constant_Nm_A
            for j in joints
        ),
        updates_Hz=1.0 / (UPDATE_CYCLES * cycle_s),
        turning_rad_s=tuple(2 * pi / (j.encoder_counts_per_turn * j.gear_ratio * cycle_s) for j in joints),
        reading_step=(
            *(
                _jump(monitors.current_noise_A) + arm.gear_stiffness_Nm_rad * speed * cycle_s / constant
            ).tolist(),
            *(_jump(monitors.resolver_noise_rad) + speed * cycle_s).tolist(),
        ),
        current_sigma_A=_compute_sigmas(monitors.current_noise_A, CURRENT_GAIN, CURRENT_UPDATES),
        wind_up_sigma_rad=_compute_sigmas(monitors.resolver_noise_rad, WIND_UP_GAIN, WIND_UP_UPDATES),
        monitored_lowest=tuple(
            np.concatenate((lowest, -lag, -over_current, coldest, -resolver_error)).tolist()
        ),
        monitored_highest=tuple(
            np.concatenate((highest, lag, over_current, hottest, resolver_error)).tolist()
        ),
    )


def _compute_sigmas(noise: float, gain: float, updates: int) -> tuple[float, ...]:
    """Compute the noise of a fast mean less a slow mean, by the number of updates of the slow mean."""
    fast = gain / (2.0 - gain)
    return tuple(noise * sqrt(fast + 1.0 / (UPDATE_CYCLES * max(n, 1))) for n in range(updates + 1))


def _jump(noise: float) -> float:
    """Compute the change of a reading from cycle to cycle that its noise explains."""
    return SIGMAS * sqrt(2.0) * noise

"""Inputs of protection: plain values about the arm and its move, bounds, and checks of the sensors.

Noisy readings are to change from cycle to cycle; gravity is to be as at the start of a move.
The records of a cycle are named tuples: a frozen dataclass takes five times as long.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import atan2, dist, hypot, pi, sin, sqrt
from operator import eq
from typing import Final, NamedTuple

import numpy as np

from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import SensorFrozen, TiltChanged
from fsw.dictionary.motion_params import MonitorParams
from fsw.dictionary.params import Params
from fsw.kinematics.arm import Arm
from fsw.kinematics.transforms import Array, Flags


class PressStatus(NamedTuple):
    """Record of a press under way."""

    tool: str
    force_N: float
    """Believed force of the tool on what it presses."""
    torque_per_N: Array
    """Change of the load on each joint per newton of force, (5,)."""
    resolver_error_at_touch_rad: Array
    """Resolver less estimated output when the tool touched, (5,)."""


class MoveStatus(NamedTuple):
    """Record of the move under way."""

    setpoint_rad: Array
    """Motor angles of this cycle, (5,)."""
    setpoint_rate_rad_s: Array
    is_stopping: bool
    """A command or a fault has stopped the move."""
    is_releasing: bool
    """The brakes are still letting go."""
    homing: Joint | None
    """Joint in homing; None if no joint is being homed."""
    approaching: str | None
    """Guarded tool that runs along its line and has not touched yet."""
    press: PressStatus | None
    """None unless a tool presses and the move is not being stopped."""


class ArmStatus(NamedTuple):
    """Record of mode, tool, estimate of the joints and move; joint arrays (5,), output side."""

    mode: Mode
    tool: str
    """Tool of the last tool command."""
    calibrated: Flags
    """Joints whose hardstop has been found."""
    motor_rad: Array
    motor_rate_rad_s: Array
    gear_rad: Array
    """Likely output less motor angle, backlash and wind-up together."""
    gear_lowest_rad: Array
    """Between this and the next friction can hold the gear angle under the likely load."""
    gear_highest_rad: Array
    gear_uncertainty_rad: Array
    """Greatest error of the likely gear angle."""
    side: Array
    """Side of the backlash, +1 or -1 if it is certain, else 0."""
    half_backlash_rad: Array
    resolver_error_rad: Array
    """Resolver less estimated output and learned bias, smoothed."""
    resolver_bias_rad: Array
    gravity_R_m_s2: Array
    """Gravity that moves are planned for, in the rover frame, (3,)."""
    imu_R_m_s2: Array
    """Gravity as the IMU reads it, smoothed, in the rover frame, (3,)."""
    move: MoveStatus | None
    """None while the arm stands on its brakes."""


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
RECENT: Final = 7
"""Last readings whose median is taken: three may be wrong, and it lags as the fast mean of currents does."""
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
    least_step_A: float
    """Distance of all currents together from the last ones within which none has changed by more."""
    least_step_rad: float
    """The same of resolver less motor angles."""
    current_sigma_A: tuple[float, ...]
    """Noise of a fast mean current less its slow mean, by the number of updates of the latter."""
    wind_up_sigma_rad: tuple[float, ...]
    """Noise of a fast mean wind-up less its slow mean, by the number of updates of the latter."""
    monitored_lowest: tuple[float, ...]
    """Lower bounds of the values that `monitors.exceed_any_bound` compares, in its order, (25,)."""
    monitored_highest: tuple[float, ...]
    """Upper bounds of the same values, (25,)."""


def compute_bounds(params: Params, arm: Arm, cycle_s: float) -> ProtectionBounds:
    """Compute the bounds of protection."""
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
    step_A = (
        _jump(monitors.current_noise_A) + arm.gear_stiffness_Nm_rad * speed * cycle_s / constant
    ).tolist()
    step_rad = (_jump(monitors.resolver_noise_rad) + speed * cycle_s).tolist()
    return ProtectionBounds(
        monitors=monitors,
        arm=arm,
        switch_names=tuple(switch.name for switch in params.switches),
        tool_switches=params.tool_switches,
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
        reading_step=(*step_A, *step_rad),
        least_step_A=min(step_A),
        least_step_rad=min(step_rad),
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


NOISY: Final = ("resolver_rad",) * 5 + ("current_A",) * 5 + ("gravity_R_m_s2",) * 3 + ("structure_C",)
"""Sensor of each number that has noise: it never stays the same for long, even at rest."""
NONE_UNCHANGED: Final = (0,) * len(NOISY)


def check_frozen(
    bounds: ProtectionBounds, unchanged: tuple[int, ...], before: tuple[float, ...], now: tuple[float, ...]
) -> tuple[tuple[int, ...], tuple[Evr, ...]]:
    """Check that no noisy reading stays the same to the last bit; count the cycles of each, as in NOISY."""
    if not any(map(eq, before, now)):
        return NONE_UNCHANGED, ()
    counts = tuple([n + 1 if a == b else 0 for a, b, n in zip(before, now, unchanged, strict=True)])
    bound = bounds.monitors.frozen_persistence
    if max(counts) < bound:
        return counts, ()
    frozen = {name: count for name, count in zip(NOISY, counts, strict=True) if count >= bound}
    return counts, tuple(SensorFrozen(name, count) for name, count in frozen.items())


def take_median(values: tuple[float, ...]) -> float:
    """Take the median of the last values of a reading; of an even number, the upper one."""
    return sorted(values)[len(values) // 2]


def check_tilt(
    bounds: ProtectionBounds, count: int, planned_R: Array, read_R: Array
) -> tuple[int, tuple[Evr, ...]]:
    """Check that gravity has the direction that the move under way was planned for.

    Both are in the rover frame, (3,), of any length. Cycles in a row beyond the bound are counted.
    """
    monitors, planned = bounds.monitors, planned_R.tolist()
    # vectors this close cannot differ more in direction
    if dist(planned, read_R.tolist()) <= sin(monitors.tilt_rad) * hypot(*planned):
        return 0, ()
    turned = atan2(float(np.linalg.norm(np.cross(planned_R, read_R))), float(planned_R @ read_R))
    if turned <= monitors.tilt_rad:
        return 0, ()
    if count + 1 < monitors.tilt_persistence:
        return count + 1, ()
    return count + 1, (TiltChanged(turned, monitors.tilt_rad),)

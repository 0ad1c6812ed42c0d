"""Contact monitors: switches that should be open or closed, and forces shown by the wind-up of the gears.

A force on the tool winds up the gears, and the resolvers show the wind-up: no force sensor is needed. A press
is compared with the force that is believed. A guarded tool that approaches a surface is monitored too: of its
two switches the one that touches first may be dead, and of a tool that meets a surface askew the other closes
late. On an approach only quick changes count, because errors of the modelled weight and of the gears change
slowly on so short a way. Where the tool has little leverage on the joints, a force is lost in the noise of
the resolvers, and only a larger one is found.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Final

import numpy as np

from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import ContactInFreeSpace, ContactLost, PreloadOutside
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.statics import held_on_flank
from fsw.kinematics.transforms import Array, Flags
from fsw.messages import Sensors
from fsw.protect.inputs import RECENT, ArmStatus, PressStatus, ProtectionBounds, take_median

FULL_LEVER_M: Final = 1.0
"""Lever of all counted joints below which the bound rises: resolver errors look like larger forces."""
LEAST_LEVER_M: Final = 0.2
"""Lever below which no force is estimated."""
MAY_TOUCH: Final = (Mode.GUARDED, Mode.RETRACTING, Mode.PRELOAD, Mode.FAULTED)
FORCE_GAIN: Final = 0.125
"""Smoothing per cycle: the force rises by newtons a cycle, and the noise of a reading is as large."""
REST_GAIN: Final = 1 / 128
"""Smoothing per cycle of the resolver error without a force."""
NOISE_RAD: Final = 2.4e-4
"""Six sigma of a resolver's noise, smoothed, and half as much again for what a built arm adds on the way."""
UNCERTAIN_RAD: Final = 1e-3
"""A gear whose angle is known no better shows no force."""


def check_unexpected_contact(
    bounds: ProtectionBounds, mode: Mode, tool: str, closed: Flags
) -> tuple[Evr, ...]:
    """Find a closed switch where nothing was to be touched: any in free space, elsewhere another tool's.

    After a fault anything may touch; the arm has been stopped.
    """
    if mode is Mode.FAULTED:
        return ()
    expected = bounds.tool_switches[tool] if mode in MAY_TOUCH else ()
    found = next((k for k in np.flatnonzero(closed) if k not in expected), None)
    return () if found is None else (ContactInFreeSpace(bounds.switch_names[found]),)


def check_contact_kept(
    bounds: ProtectionBounds, count: int, press: PressStatus, closed: Flags
) -> tuple[int, tuple[Evr, ...]]:
    """Check that a tool that presses has a switch closed; count the cycles in a row without one.

    One closed switch is enough, so that another may be dead. With no more force than a guarded tool may have
    all may be open: gears cross their backlash during a touch, which ends only when a switch is closed.
    """
    is_firm = press.force_N > bounds.monitors.guarded_force_N
    if not is_firm or any(closed[k] for k in bounds.tool_switches[press.tool]):
        return 0, ()
    lost = count + 1 >= bounds.monitors.contact_persistence
    return count + 1, (ContactLost(press.tool),) if lost else ()


def check_press_force(
    bounds: ProtectionBounds, count: int, arm: ArmStatus, press: PressStatus
) -> tuple[int, tuple[Evr, ...]]:
    """Check that a tool presses with the force that is believed; count the cycles in a row that it is not."""
    monitors = bounds.monitors
    error_N, lever_m = estimate_force_error(bounds, arm, press)
    known_N = monitors.preload_error_N + bounds.press_error_share * press.force_N
    bound_N = known_N * max(1.0, FULL_LEVER_M / lever_m)
    if abs(error_N) <= bound_N:
        return 0, ()
    if count + 1 < monitors.preload_persistence:
        return count + 1, ()
    return count + 1, (PreloadOutside(press.tool, press.force_N, error_N, bound_N),)


def estimate_force_error(bounds: ProtectionBounds, arm: ArmStatus, press: PressStatus) -> tuple[float, float]:
    """Estimate true less believed force [N] of a press by the wind-up of gears, and the lever [m] of these.

    An output that is farther along than estimated carries more than estimated. The force is the least-squares
    fit to the torques that the joints carry too much. Resolver errors at the touch, when the gears carried
    the arm alone, are subtracted first, and then the uncertainty of the gear angles.

    A joint does not count if a force off by half its bound could take its output to the other side of the
    backlash: an early or late crossing is no force.
    """
    stiffness, monitors = bounds.arm.gear_stiffness_Nm_rad, bounds.monitors
    margin = 0.5 * monitors.preload_error_N * np.abs(press.torque_per_N) / stiffness
    held = held_on_flank(arm.half_backlash_rad, arm.gear_lowest_rad, arm.gear_highest_rad, margin)
    counts = held & arm.calibrated
    error_rad = arm.resolver_error_rad - press.resolver_error_at_touch_rad
    sure_rad = np.maximum(np.abs(error_rad) - arm.gear_uncertainty_rad, 0.0) * np.sign(error_rad)
    per_N = press.torque_per_N[counts]
    square = float(per_N @ per_N)
    if square < LEAST_LEVER_M**2:
        return 0.0, LEAST_LEVER_M
    return float(per_N @ (stiffness * sure_rad)[counts]) / square, sqrt(square)


@dataclass(frozen=True, slots=True, eq=False)
class ApproachState:
    """Sensorless contact monitor from cycle to cycle of an approach."""

    rad_per_N: Array
    """Wind-up of each gear per newton; 0 for a joint that shows nothing, (5,)."""
    rest_rad: Array
    """Resolver less estimated output without a force, slowly followed, (5,)."""
    force_N: float
    """Force on the tool, smoothed."""
    recent_N: tuple[float, ...] = ()
    """Forces by the last readings alone, the newest first."""


def monitor_approach(
    bounds: ProtectionBounds, last: ApproachState | None, arm: ArmStatus, sensors: Sensors
) -> tuple[ApproachState | None, tuple[Evr, ...]]:
    """Check that nothing presses on a guarded tool that has not closed a switch yet.

    The state is None unless a tool approaches.
    """
    tool = None if arm.move is None else arm.move.approaching
    if tool is None:
        return None, ()
    if last is None:
        return ApproachState(_compute_wind_up(bounds, arm, tool), arm.resolver_error_rad, 0.0), ()
    per_N = np.where(arm.gear_uncertainty_rad < UNCERTAIN_RAD, last.rad_per_N, 0.0)
    square = float(per_N @ per_N)
    if square == 0.0:
        return last, ()
    estimated = arm.motor_rad + arm.gear_rad + arm.resolver_bias_rad
    wound_rad = sensors.resolver_rad - estimated - last.rest_rad
    now_N = float(per_N @ wound_rad) / square
    bound_N = max(bounds.monitors.guarded_force_N, NOISE_RAD / sqrt(square))
    force_N = last.force_N + FORCE_GAIN * (now_N - last.force_N)
    recent_N = (now_N, *last.recent_N[: RECENT - 1])
    found: tuple[Evr, ...] = ()
    # a few wrong readings raise the smoothed force, and not their median
    if force_N > bound_N and 2.0 * take_median(recent_N) > bound_N:
        found = (PreloadOutside(tool, 0.0, force_N, bound_N),)
    return ApproachState(per_N, last.rest_rad + REST_GAIN * wound_rad, force_N, recent_N), found


def _compute_wind_up(bounds: ProtectionBounds, arm: ArmStatus, tool: str) -> Array:
    """Compute the wind-up of each gear per newton against the approach of a tool, (5,)."""
    frames = forward(bounds.arm, arm.motor_rad + arm.gear_rad)
    X_RT = tool_pose(bounds.arm, frames, tool)
    torque_Nm_N = -joint_jacobian(frames, X_RT.p)[3:].T @ X_RT.R[:, 0]
    # an output that crosses its backlash on the way looks like a force
    held = held_on_flank(
        arm.half_backlash_rad, arm.gear_lowest_rad, arm.gear_highest_rad, bounds.approach_wind_up_rad
    )
    wind_up: Array = np.where(held, torque_Nm_N / bounds.arm.gear_stiffness_Nm_rad, 0.0)
    return wind_up

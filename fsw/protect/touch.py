"""Monitors of what the arm touches: where nothing should be, where something should, and how hard."""

from math import sqrt
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import ContactInFreeSpace, ContactLost, PreloadOutside
from fsw.dictionary.joints import SWITCHES_OF, Switch, Tool
from fsw.dictionary.modes import Mode
from fsw.estimate.gear import held_on_side
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array
from fsw.messages import Flags
from fsw.motion.plan_press import Pressing

FULL_LEVER_M: Final = 1.0
"""With less, all joints that count together, what a resolver does not know is more of a force."""
LEAST_LEVER_M: Final = 0.2
"""And with less than this too much."""
MAY_TOUCH = (Mode.GUARDED, Mode.RETRACTING, Mode.PRELOAD, Mode.FAULTED)


def contact(mode: Mode, tool: Tool, closed: Flags) -> tuple[Evr, ...]:
    """A closed switch where nothing was to be touched: any in free space, elsewhere another tool's.

    Of an arm that faulted anything may touch; it has been stopped.
    """
    expected: tuple[Switch, ...] = ()
    if mode in MAY_TOUCH:
        expected = tuple(Switch) if mode is Mode.FAULTED else SWITCHES_OF[tool]
    found = next((switch for switch in Switch if closed[switch] and switch not in expected), None)
    return () if found is None else (ContactInFreeSpace(found),)


def contact_lost(config: Config, last: int, pressing: Pressing, closed: Flags) -> tuple[int, tuple[Evr, ...]]:
    """A tool that is to press and has no switch closed: how many cycles it has been so, and what was found.

    One closed switch is enough, so that the other may be dead. With less than the smallest step of a press
    a switch may well be open.
    """
    firm = pressing.force_N > config.params.preload.step_N
    if not firm or any(closed[switch] for switch in SWITCHES_OF[pressing.tool]):
        return 0, ()
    lost = last + 1 >= config.params.monitors.contact_persistence
    return last + 1, (ContactLost(pressing.tool),) if lost else ()


def preload_outside(
    config: Config, last: int, pressing: Pressing, torque_per_N: Array, joints: JointEstimate
) -> tuple[int, tuple[Evr, ...]]:
    """A force on the tool that is not the one that it is believed to press with.

    `torque_per_N` is by how much each joint's load rises with the force, (5,).
    """
    bounds = config.params.monitors
    error_N, lever_m = force_error_N(config, torque_per_N, joints, pressing.rest_rad)
    known_N = bounds.preload_error_N + config.params.preload.error_share * pressing.force_N
    bound_N = known_N * max(1.0, FULL_LEVER_M / lever_m)
    if abs(error_N) <= bound_N:
        return 0, ()
    if last + 1 < bounds.preload_persistence:
        return last + 1, ()
    return last + 1, (PreloadOutside(pressing.tool, pressing.force_N, error_N, bound_N),)


def force_error_N(
    config: Config, torque_per_N: Array, joints: JointEstimate, rest_rad: Array
) -> tuple[float, float]:
    """True less believed force on a tool, as far as the resolvers tell it through the wind-up of the gears.

    And the lever [m] that the joints which tell it have together.

    An output that is farther along than believed carries more than believed; of what each joint carries too
    much, the part that a force takes is the least-squares fit. What the resolvers were off at the touch, when
    the gears carried the arm alone, does not count. What is not known of a gear angle is taken off first, and
    joints do not count that a force off by half its bound could take to the other side of their gap: a gap
    that is crossed early or late is no force.
    """
    stiffness, half = config.arm.gear_stiffness_Nm_rad, joints.reference.half_gap_rad
    room = 0.5 * config.params.monitors.preload_error_N * np.abs(torque_per_N) / stiffness
    counts = held_on_side(half, joints.bounds, room) & joints.reference.calibrated
    error_rad = joints.resolver_error_rad - rest_rad
    sure_rad = np.maximum(np.abs(error_rad) - joints.uncertainty_rad, 0.0) * np.sign(error_rad)
    per_N = torque_per_N[counts]
    square = float(per_N @ per_N)
    if square < LEAST_LEVER_M**2:
        return 0.0, LEAST_LEVER_M
    return float(per_N @ (stiffness * sure_rad)[counts]) / square, sqrt(square)

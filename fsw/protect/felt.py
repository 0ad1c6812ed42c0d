"""The force on a guarded tool as the wind-up of the gears tells it, for when no switch does.

Of two switches the one that touches first may be dead, and of a tool that meets a surface askew the other
closes late. Only what changes quickly counts: what parameters miss of the arm's own weight, and what is
wrongly believed of a gear, changes slowly on so short a way. Where the tool has little leverage on the joints
a force is lost in the noise of the resolvers, and only a larger one is felt.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import PreloadOutside
from fsw.dictionary.joints import Tool
from fsw.estimate.gear import LIKELY, held_on_side
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.motion.move import Move, Phase
from fsw.motion.paths import LinePath

FELT_GAIN: Final = 0.125
"""Of the smoothing, per cycle: the force rises by newtons a cycle, and the noise of a reading is as large."""
REST_GAIN: Final = 1 / 128
"""Of what is taken for the arm's own, per cycle."""
NOISE_RAD: Final = 2.4e-4
"""Six sigma of a resolver's noise, smoothed, and half as much again for what a built arm adds on the way."""
FIRM: Final = 5.0
"""Times what a modelled load may be off."""
UNSURE_RAD: Final = 1e-3
"""A gear whose angle is known no better says nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """A guarded travel, felt."""

    rad_per_N: Array
    """By how much the force winds up each gear; 0 for a joint that says nothing, (5,)."""
    rest_rad: Array
    """How far the resolvers are from the believed outputs without a force: slowly followed."""
    force_N: float


def felt(
    config: Config, last: Felt | None, move: Move | None, sensors: Sensors, joints: JointEstimate
) -> tuple[Felt | None, tuple[Evr, ...]]:
    """What is felt for the next cycle, None unless a guarded tool travels freely, and what was found."""
    if move is None or move.guarded is None or move.contact_at is not None or move.phase is not Phase.RUN:
        return None, ()
    if not isinstance(move.paths[0], LinePath):
        return None, ()
    if last is None:
        return Felt(_wind_up(config, move.guarded, joints), joints.resolver_error_rad, 0.0), ()
    per_N = np.where(joints.uncertainty_rad < UNSURE_RAD, last.rad_per_N, 0.0)
    square = float(per_N @ per_N)
    if square == 0.0:
        return last, ()
    believed = joints.motor_rad + joints.gear_rad[:, LIKELY] + joints.reference.resolver_bias_rad
    wound_rad = sensors.resolver_rad - believed - last.rest_rad
    now_N = float(per_N @ wound_rad) / square
    force_N = last.force_N + FELT_GAIN * (now_N - last.force_N)
    bound_N = max(config.params.monitors.guarded_force_N, NOISE_RAD / sqrt(square))
    found = (PreloadOutside(move.guarded, 0.0, force_N, bound_N),) if force_N > bound_N else ()
    return Felt(per_N, last.rest_rad + REST_GAIN * wound_rad, force_N), found


def _wind_up(config: Config, tool: Tool, joints: JointEstimate) -> Array:
    """By how much a force against the tool's approach winds up each gear, (5,)."""
    frames = forward(config.arm, joints.output_rad)
    X_RT = tool_pose(config.arm, frames, tool)
    torque_Nm_N = -joint_jacobian(frames, X_RT.p)[3:].T @ X_RT.R[:, 0]
    # one that crosses its gap on the way feels like a force
    stiffness, half = config.arm.gear_stiffness_Nm_rad, joints.reference.half_gap_rad
    firm = held_on_side(half, joints.bounds, FIRM * config.load_error_Nm / stiffness)
    wind_up: Array = np.where(firm, torque_Nm_N / stiffness, 0.0)
    return wind_up

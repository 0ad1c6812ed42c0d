"""Placements of a tool, with two move models: closed loop of plant and flight software, or statics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config, configure, configure_at
from fsw.dictionary.commands import BacklashMode, MoveTool
from fsw.dictionary.types import joints5, vector3
from fsw.estimate.reference import Reference, no_reference
from fsw.kinematics.arm import heat_arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose
from marsarm.accuracy.sensitivity import workspace_poses
from sim.arms import BuiltArm
from sim.avionics import move_rng
from sim.effects.effect import (
    EachMove,
    Hardware,
    draw_move_disturbance,
    hardware_with_effects,
    nominal_hardware,
    params_with_effects,
)
from sim.loop import Setup, hardware_rng
from sim.pose_sequence import describe_no_way, free_air_loop, run_and_rest
from sim.quasi_static import StaticArm, solve_quasi_static_move
from sim.world import World

START_OFFSET_RAD: Final = 0.05
"""Offset of the start of a move from its end, each joint to a random side; wider than any backlash."""
LIMIT_MARGIN_RAD: Final = 0.01
"""Distance of the start from the soft limits."""
POSES_PER_PLACEMENT: Final = 20
"""Number of drawn poses for each placement, from which the placement is picked at random."""


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Commanded placement of a tool."""

    tool: str
    start_rad: Array
    output_rad: Array
    X_RT: Pose
    seed: int
    """Seed of the random errors of the move."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlacement:
    """Error of a tool at a placement."""

    tool: str
    output_rad: Array
    """Commanded joint angles, shape (5,)."""
    error: Array
    """Screw [rad, m] from commanded to true pose in tool axes, shape (6,).

    The rotation about x is not commanded, and is 0.
    """
    backlash_position: Array
    """Positions of the outputs in their backlash, -1 and +1 at the flanks, shape (5,)."""


MoveModel = Callable[[Placement], tuple[Pose, Array]]
"""Function from a placement to the true tool pose and the positions of the outputs in their backlash."""


def configure_believed(arm: BuiltArm) -> Config:
    """Configure flight software of an arm for the temperature that its sensor reads."""
    hardware = _hardware(arm)
    return configure_at(configure(arm.params), hardware.structure_C + hardware.structure_offset_K)


def configure_true(arm: BuiltArm) -> Config:
    """Configure flight software that knows an arm exactly, with the arm as it is at its temperature."""
    drawn = arm.model.params
    cold = configure(params_with_effects(arm.effects, drawn))
    return replace(cold, arm=heat_arm(cold.arm, _hardware(arm).structure_C - drawn.heat.calibration_C))


def _hardware(arm: BuiltArm) -> Hardware:
    """Return avionics and sensors without the effects of each move, which draw their own errors."""
    lasting = (effect for effect in arm.effects if not isinstance(effect, EachMove))
    return hardware_with_effects(lasting, nominal_hardware(arm.model.description))


def random_placements(
    believed: Config, tool: str, count: int, seed: np.random.SeedSequence
) -> list[Placement]:
    """Draw placements over workspace and branches, for the arm as flight software knows it."""
    arm, gravity = believed.arm, World().gravity_N_m_s2
    rng = np.random.default_rng(seed)
    poses = workspace_poses(arm, tool, gravity, POSES_PER_PLACEMENT * count, int(rng.integers(2**31)))
    # neighbouring poses are branches of one target, so draw at random
    output = poses.output_rad[:, rng.choice(POSES_PER_PLACEMENT * count, count, replace=False)]
    X_RT = [tool_pose(arm, settle_output(arm, q_rad, gravity).frames, tool) for q_rad in output.T]
    offset = START_OFFSET_RAD * rng.choice([-1.0, 1.0], output.shape)
    low, high = (
        limit[:, None] for limit in (arm.soft_min_rad + LIMIT_MARGIN_RAD, arm.soft_max_rad - LIMIT_MARGIN_RAD)
    )
    start = np.clip(output + offset, low, high)
    seeds = rng.integers(2**31, size=count)
    return [Placement(tool, start[:, k], output[:, k], X_RT[k], int(seeds[k])) for k in range(count)]


def measure_placements(move: MoveModel, places: Sequence[Placement]) -> list[MeasuredPlacement]:
    """Move to each placement and measure the error."""
    found = []
    for place in places:
        X_RT, position = move(place)
        found.append(
            MeasuredPlacement(place.tool, place.output_rad, error_in_tool(place.X_RT, X_RT), position)
        )
    return found


def error_in_tool(commanded: Pose, true: Pose) -> Array:
    """Compute the tool error.

    Args:
        commanded: Commanded tool pose X_RT.
        true: True tool pose X_RT.

    Returns:
        Screw [rad, m] from commanded to true pose in tool axes without the rotation about x, shape (6,).
    """
    turn = true.R.T @ np.cross(commanded.R[:, 0], true.R[:, 0])
    return np.concatenate([turn, true.R.T @ (true.p - commanded.p)])


def closed_loop_model(arm: BuiltArm, reference: Reference, backlash: BacklashMode) -> MoveModel:
    """Build the move model of plant and flight software in free air.

    The model raises RuntimeError if a move fails.
    """

    def move(place: Placement) -> tuple[Pose, Array]:
        loop = free_air_loop(Setup(arm, World(), joints5(place.start_rad), place.seed, reference))
        X_RT = place.X_RT
        command = MoveTool(place.tool, vector3(X_RT.p), vector3(X_RT.R[:, 0]), backlash=backlash)
        problem = run_and_rest(loop, command)
        if problem is not None:
            raise RuntimeError(describe_no_way(arm, place.output_rad, problem))
        truth, plant = loop.truth(), loop.plant
        index = plant.tools.index(place.tool)
        X_RT = Pose(truth.R_RT[index], truth.p_RoTo_R_m[index])
        return X_RT, plant.backlash_rad() / plant.half_backlash_rad

    return move


def statics_model(arm: BuiltArm, believed: Config, backlash: BacklashMode) -> MoveModel:
    """Build the move model of static equilibrium, with an initialisation without errors.

    The gears have the wind-up and the side of the backlash that the move leaves.

    Args:
        arm: Arm as it is built.
        believed: Arm as flight software knows it, see `configure_believed`.
        backlash: Compensation of the backlash.
    """
    true = configure_true(arm)
    static = StaticArm(believed, true, no_reference(believed), true.hardstop_rad - believed.hardstop_rad)
    random_effects = [effect for effect in arm.effects if isinstance(effect, EachMove)]
    gravity = World().gravity_N_m_s2

    def move(place: Placement) -> tuple[Pose, Array]:
        disturbance = draw_move_disturbance(random_effects, move_rng(hardware_rng(place.seed)))
        settled = solve_quasi_static_move(
            static, place.start_rad, place.output_rad, place.tool, gravity, backlash, disturbance
        )
        return settled.X_RT, settled.backlash_rad / true.half_backlash_rad

    return move

"""Two ways to move an arm to a place: plant and flight software, or where statics leave it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import BacklashMode, MoveTool
from fsw.dictionary.enums import Tool
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5, vector3
from fsw.estimate.reference import Reference, no_reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose
from ground.accuracy.sensitivity import workspace_poses
from sim.arms import BuiltArm
from sim.avionics import move_rng
from sim.effects.effect import EachMove, draw_move_disturbance, params_with_effects
from sim.loop import Setup, hardware_rng
from sim.params import nominal_params
from sim.pose_sequence import free_air_loop, run_and_rest
from sim.quasi_static import StaticArm, solve_quasi_static_move
from sim.world import World

START_OFFSET_RAD: Final = 0.05
"""From where a move to a place begins, each joint to one side or the other: farther than any gap is wide."""
LIMIT_MARGIN_RAD: Final = 0.01
"""How far from the soft limits."""
POSES_PER_PLACEMENT: Final = 20
"""Times as many poses as places, of which places are picked at random."""


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a tool is to be, and how."""

    tool: Tool
    start_rad: Array
    output_rad: Array
    X_RT: Pose
    seed: int
    """Of what the move leaves to chance."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlacement:
    """By how much a tool misses its place."""

    tool: Tool
    output_rad: Array
    """Of the commanded pose, (5,)."""
    error: Array
    """Screw in tool axes, from commanded to true, (6,); a turn about x is not commanded, and left out."""
    gap: Array
    """Where the outputs lie in their gaps: -1 and +1 are the flanks, (5,)."""


MoveModel = Callable[[Placement], tuple[Pose, Array]]
"""From a place to where the tool came to rest, and to where the outputs lie in their gaps."""


def random_placements(
    params: Params, tool: Tool, count: int, seed: np.random.SeedSequence
) -> list[Placement]:
    """Poses over workspace and branches, as flight software believes the arm to hang on Mars."""
    arm, gravity = build_arm(params), World().gravity_N_m_s2
    rng = np.random.default_rng(seed)
    poses = workspace_poses(arm, tool, gravity, POSES_PER_PLACEMENT * count, int(rng.integers(2**31)))
    # neighbours are branches of one target
    output = poses.output_rad[:, rng.choice(POSES_PER_PLACEMENT * count, count, replace=False)]
    X_RT = tool_pose(arm, settle_output(arm, output, gravity).frames, tool)
    away = START_OFFSET_RAD * rng.choice([-1.0, 1.0], output.shape)
    low, high = (
        limit[:, None] for limit in (arm.soft_min_rad + LIMIT_MARGIN_RAD, arm.soft_max_rad - LIMIT_MARGIN_RAD)
    )
    start = np.clip(output + away, low, high)
    seeds = rng.integers(2**31, size=count)
    return [Placement(tool, start[:, k], output[:, k], X_RT[k], int(seeds[k])) for k in range(count)]


def measure_placements(moved: MoveModel, places: Sequence[Placement]) -> list[MeasuredPlacement]:
    """What came of moves to these places."""
    found = []
    for place in places:
        X_RT, gap = moved(place)
        found.append(MeasuredPlacement(place.tool, place.output_rad, error_in_tool(place.X_RT, X_RT), gap))
    return found


def error_in_tool(commanded: Pose, true: Pose) -> Array:
    """The screw from commanded to true in tool axes, (6,), without the turn about x."""
    turn = true.R.T @ np.cross(commanded.R[:, 0], true.R[:, 0])
    return np.concatenate([turn, true.R.T @ (true.p - commanded.p)])


def closed_loop_model(arm: BuiltArm, reference: Reference, backlash: BacklashMode) -> MoveModel:
    """Plant and flight software, in free air.

    The move raises RuntimeError if it does not come to its end.
    """

    def moved(place: Placement) -> tuple[Pose, Array]:
        loop = free_air_loop(Setup(arm, World(), joints5(place.start_rad), place.seed, reference))
        X_RT = place.X_RT
        command = MoveTool(place.tool, vector3(X_RT.p), vector3(X_RT.R[:, 0]), backlash=backlash)
        problem = run_and_rest(loop, command)
        if problem is not None:
            raise RuntimeError(f"{arm.name}: no way to {np.degrees(place.output_rad)} deg: {problem}")
        truth, plant = loop.truth(), loop.plant
        X_RT = Pose(truth.R_RT[place.tool], truth.p_RoTo_R_m[place.tool])
        return X_RT, plant.gap_rad() / plant.half_gap_rad

    return moved


def statics_model(arm: BuiltArm, backlash: BacklashMode) -> MoveModel:
    """The equilibrium of the arm, its gears as the move leaves them; initialised without any error."""
    believed, true = configure(arm.params), configure(params_with_effects(arm.effects, _nominal_params()))
    static = StaticArm(believed, true, no_reference(believed), true.hardstop_rad - believed.hardstop_rad)
    by_chance = [effect for effect in arm.effects if isinstance(effect, EachMove)]
    gravity = World().gravity_N_m_s2

    def moved(place: Placement) -> tuple[Pose, Array]:
        scatter = draw_move_disturbance(by_chance, move_rng(hardware_rng(place.seed)))
        settled = solve_quasi_static_move(
            static, place.start_rad, place.output_rad, place.tool, gravity, backlash, scatter
        )
        return settled.X_RT, settled.gap_rad / true.half_gap_rad

    return moved


@cache
def _nominal_params() -> Params:
    return nominal_params()

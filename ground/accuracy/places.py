"""Places of the workspace that a tool is moved to, and by how much it misses them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.dictionary.params import Params
from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose
from ground.accuracy.poses import workspace_poses
from sim.world import World

AWAY_RAD: Final = 0.05
"""From where a move to a place begins, each joint to one side or the other: farther than any gap is wide."""
INSIDE_RAD: Final = 0.01
"""How far from the soft limits."""
ENOUGH: Final = 20
"""Times as many poses as places, of which places are picked at random."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a tool is to be, and how."""

    tool: Tool
    start_rad: Array
    output_rad: Array
    X_RT: Pose
    seed: int
    """Of what the move leaves to chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """By how much a tool misses its place."""

    tool: Tool
    output_rad: Array
    """Of the commanded pose, (5,)."""
    error: Array
    """Screw in tool axes, from commanded to true, (6,); a turn about x is not commanded, and left out."""
    gap: Array
    """Where the outputs lie in their gaps: -1 and +1 are the flanks, (5,)."""


Moved = Callable[[Place], tuple[Pose, Array]]
"""From a place to where the tool came to rest, and to where the outputs lie in their gaps."""


def random_places(params: Params, tool: Tool, count: int, seed: np.random.SeedSequence) -> list[Place]:
    """Poses over workspace and branches, as flight software believes the arm to hang on Mars."""
    arm, gravity = build_arm(params), World().gravity_N_m_s2
    rng = np.random.default_rng(seed)
    poses = workspace_poses(arm, tool, gravity, ENOUGH * count, int(rng.integers(2**31)))
    # neighbours are branches of one target
    output = poses.output_rad[:, rng.choice(ENOUGH * count, count, replace=False)]
    X_RT = tool_pose(arm, settle_output(arm, output, gravity).frames, tool)
    away = AWAY_RAD * rng.choice([-1.0, 1.0], output.shape)
    low, high = (limit[:, None] for limit in (arm.soft_min_rad + INSIDE_RAD, arm.soft_max_rad - INSIDE_RAD))
    start = np.clip(output + away, low, high)
    seeds = rng.integers(2**31, size=count)
    return [Place(tool, start[:, k], output[:, k], X_RT[k], int(seeds[k])) for k in range(count)]


def measured(moved: Moved, places: Sequence[Place]) -> list[Measured]:
    """What came of moves to these places."""
    found = []
    for place in places:
        X_RT, gap = moved(place)
        found.append(Measured(place.tool, place.output_rad, error_in_tool(place.X_RT, X_RT), gap))
    return found


def error_in_tool(commanded: Pose, true: Pose) -> Array:
    """The screw from commanded to true in tool axes, (6,), without the turn about x."""
    turn = true.R.T @ np.cross(commanded.R[:, 0], true.R[:, 0])
    return np.concatenate([turn, true.R.T @ (true.p - commanded.p)])

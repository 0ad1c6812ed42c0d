"""The poses of a campaign: random over the workspace, clear of everything, three in ten shoulder-in."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.enums import Tool
from fsw.dictionary.params import Params
from fsw.kinematics.branches import BRANCHES, branch_index, fold_distances
from fsw.kinematics.transforms import Array
from sim.clearance import ClearanceModel
from sim.effects.structure import params_with_stand_in
from sim.pose_sequence import pose_in_workspace
from sim.world import World

SHOULDER_IN: Final = 0.3
CLEAR_M: Final = 0.01
OUT, IN = BRANCHES[:4], BRANCHES[4:]


@dataclass(frozen=True, slots=True)
class Group:
    """A part of a campaign: which turret hangs on the arm, how the rover is tilted, how many poses."""

    turret_kg: float | None
    """None for the arm's own."""
    roll_rad: float
    count: int

    def params(self, params: Params) -> Params:
        """Flight parameters of the arm with this turret."""
        return params_with_stand_in(params, self.turret_kg)


PAPER_GROUPS: Final = tuple(
    Group(kg, float(np.radians(roll_deg)), 40) for roll_deg in (0.0, 20.0) for kg in (8.0, 19.0)
)
"""Two light turrets on level ground, then both with the rover rolled by 20 deg."""


def resized(groups: tuple[Group, ...], poses: int) -> tuple[Group, ...]:
    """The same groups with so many poses in all."""
    share, left = divmod(poses, len(groups))
    return tuple(Group(g.turret_kg, g.roll_rad, share + (k < left)) for k, g in enumerate(groups))


def group_poses(params: Params, group: Group, scene: World, rng: np.random.Generator) -> list[Array]:
    """Goals (5) of joint angles, in an order in which the way between them is short, from the ready pose."""
    config = configure(group.params(params))
    space = ClearanceModel(config.params, scene)
    inside = round(SHOULDER_IN * group.count)
    branches = [IN] * inside + [OUT] * (group.count - inside)
    goals = [_clear_pose(config, space, rng, names) for names in branches]
    return nearest_next(config, np.array(config.params.poses.ready_rad), goals)


def _clear_pose(
    config: Config, space: ClearanceModel, rng: np.random.Generator, names: tuple[str, ...]
) -> Array:
    while True:
        pose = pose_in_workspace(config, rng, Tool.DRILL, names)
        clearance = space.clearance(pose[:, None])
        if min(clearance.outside_m, clearance.self_m) > CLEAR_M:
            return pose


def nearest_next(config: Config, start_rad: Array, goals: list[Array]) -> list[Array]:
    """The goals, each time the one that is reached soonest."""
    left, ordered, here = list(goals), [], start_rad
    while left:
        time_s = [float(np.max(np.abs(goal - here) / config.speed_rad_s)) for goal in left]
        here = left.pop(int(np.argmin(time_s)))
        ordered.append(here)
    return ordered


def branch_name(config: Config, output_rad: Array) -> str:
    """The branch of the inverse kinematics that a pose (5,) is on."""
    return BRANCHES[int(branch_index(fold_distances(config.arm.orthogonal[Tool.DRILL], output_rad)))]

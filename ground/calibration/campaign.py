"""The campaign in the closed loop: hardstops first, then flight software goes to every pose."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import HARDSTOP_ORDER, Tool
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5
from fsw.estimate.gear import LIKELY, clip_to_backlash
from fsw.estimate.reference import Reference
from fsw.kinematics.branches import BRANCHES, branch_index, fold_distances
from fsw.kinematics.transforms import Array
from ground.calibration.campaign_data import Campaign
from ground.calibration.survey import CampaignRow, TooFewTargets, measure_pose, stack_rows
from ground.common.progress import Progress
from sim.arms import BuiltArm
from sim.clearance import ClearanceModel
from sim.effects.structure import StandInTurret, params_with_stand_in
from sim.hardstop_loads import without_turret
from sim.initialisation import initialise_joints
from sim.loop import ClosedLoop, Setup
from sim.pose_sequence import free_air_loop, pose_in_workspace, run_and_rest
from sim.sequence import Outcome
from sim.tracker import TYPICAL_TRACKER, Tracker, turret_pose
from sim.world import World

SHOULDER_IN_SHARE: Final = 0.3
MIN_CLEARANCE_M: Final = 0.01
SHOULDER_OUT_BRANCHES, SHOULDER_IN_BRANCHES = BRANCHES[:4], BRANCHES[4:]


@dataclass(frozen=True, slots=True)
class PoseGroup:
    """A part of a campaign: which turret hangs on the arm, how the rover is tilted, how many poses."""

    turret_kg: float | None
    """None for the arm's own."""
    roll_rad: float
    count: int

    def params(self, params: Params) -> Params:
        """Flight parameters of the arm with this turret."""
        return params_with_stand_in(params, self.turret_kg)


PAPER_GROUPS: Final = tuple(
    PoseGroup(kg, float(np.radians(roll_deg)), 40) for roll_deg in (0.0, 20.0) for kg in (8.0, 19.0)
)
"""Two light turrets on level ground, then both with the rover rolled by 20 deg."""


def resize_groups(groups: tuple[PoseGroup, ...], poses: int) -> tuple[PoseGroup, ...]:
    """The same groups with so many poses in all."""
    share, left = divmod(poses, len(groups))
    return tuple(PoseGroup(g.turret_kg, g.roll_rad, share + (k < left)) for k, g in enumerate(groups))


def group_poses(params: Params, group: PoseGroup, scene: World, rng: np.random.Generator) -> list[Array]:
    """Goals (5) of joint angles, in an order in which the way between them is short, from the ready pose."""
    config = configure(group.params(params))
    space = ClearanceModel(config.params, scene)
    inside = round(SHOULDER_IN_SHARE * group.count)
    branches = [SHOULDER_IN_BRANCHES] * inside + [SHOULDER_OUT_BRANCHES] * (group.count - inside)
    goals = [_clear_pose(config, space, rng, names) for names in branches]
    return order_by_time(config, np.array(config.params.poses.ready_rad), goals)


def _clear_pose(
    config: Config, space: ClearanceModel, rng: np.random.Generator, names: tuple[str, ...]
) -> Array:
    while True:
        pose = pose_in_workspace(config, rng, Tool.DRILL, names)
        clearance = space.clearance(pose[:, None])
        if min(clearance.outside_m, clearance.self_m) > MIN_CLEARANCE_M:
            return pose


def order_by_time(config: Config, start_rad: Array, goals: list[Array]) -> list[Array]:
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


class CampaignFailed(RuntimeError):
    """The arm could not be initialised, or a move did not come to its end."""


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """What is done, and with what."""

    groups: tuple[PoseGroup, ...] = PAPER_GROUPS
    tracker: Tracker = TYPICAL_TRACKER
    seed: int = 0


def earth_reference(arm: BuiltArm, progress: Progress) -> Reference:
    """Every joint at its hardstop, without a turret on Earth, under the torques that it has on Mars with it.

    Raises:
        CampaignFailed: a hardstop was not found.
    """
    runs = []
    for run in initialise_joints(without_turret(arm, on_earth=True), World("earth")):
        runs.append(run)
        progress(len(runs), len(HARDSTOP_ORDER), "hardstops")
    if runs[-1].outcome is not Outcome.DONE:
        raise CampaignFailed(f"{arm.name} was not initialised: {runs[-1].evrs[-1][1].message}")
    return runs[-1].reference


def run_campaign(arm: BuiltArm, reference: Reference, plan: CampaignPlan, progress: Progress) -> Campaign:
    """Every pose of the plan.

    Raises:
        CampaignFailed: a move did not come to its end.
    """
    total, rows = sum(group.count for group in plan.groups), []
    for k in range(len(plan.groups)):
        for row in group_rows(arm, reference, plan, k):
            rows.append(row)
            progress(len(rows), total, "poses")
    return stack_rows(arm.name, rows)


def group_rows(arm: BuiltArm, reference: Reference, plan: CampaignPlan, k: int) -> Iterator[CampaignRow]:
    """The poses of one group, one after the other; those that the tracker cannot see are not among them."""
    group = plan.groups[k]
    world = World("earth", tilt_roll_rad=group.roll_rad)
    goals = group_poses(arm.params, group, World("earth"), np.random.default_rng([plan.seed, k, 0]))
    rng = np.random.default_rng([plan.seed, k, 1])
    turret = () if group.turret_kg is None else (StandInTurret(group.turret_kg),)
    known = replace(arm, params=group.params(arm.params))
    setup = Setup(known, world, known.params.poses.ready_rad, plan.seed, reference, turret)
    loop = free_air_loop(setup)  # the way between two poses was cleared by people
    for goal in goals:
        problem = run_and_rest(loop, MoveJoints(joints5(goal), "on"))
        if problem is not None:
            raise CampaignFailed(f"{arm.name}: no way to {np.degrees(goal)} deg: {problem}")
        try:
            yield _row(loop, group, k, plan.tracker, rng)
        except TooFewTargets:
            continue


def _row(
    loop: ClosedLoop, group: PoseGroup, k: int, tracker: Tracker, rng: np.random.Generator
) -> CampaignRow:
    loop.plant.truth()  # brings the kinematics up to date
    seen = measure_pose(tracker, loop.plant, group.roll_rad, turret_pose(loop.plant), rng)
    joints, arm = loop.state.joints, loop.config.arm
    gear = joints.gear_rad[:, LIKELY]
    gap = clip_to_backlash(joints.reference.half_gap_rad, gear)
    return CampaignRow(
        group=k,
        branch=branch_name(loop.config, joints.output_rad),
        motor_rad=joints.motor_rad,
        backlash_rad=gap,
        friction_Nm=loop.state.load.torque_Nm - arm.gear_stiffness_Nm_rad * (gear - gap),
        side=joints.side,
        gravity_R_m_s2=joints.gravity_R_m_s2,
        turret_kg=np.nan if group.turret_kg is None else group.turret_kg,
        measurement=seen,
    )

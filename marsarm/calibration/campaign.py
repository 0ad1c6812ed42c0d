"""Calibration campaign in the closed loop: find the hardstops, then move to every pose and measure it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import HARDSTOP_ORDER
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5
from fsw.estimate.gear import LIKELY, clip_to_backlash
from fsw.estimate.reference import Reference
from fsw.kinematics.closed_form import BRANCHES, branch_index, fold_distances
from fsw.kinematics.transforms import Array
from marsarm.calibration.campaign_data import Campaign
from marsarm.calibration.survey import CampaignRow, TooFewTargets, measure_pose, stack_rows
from sim.arm_check import NoPlan
from sim.arms import BuiltArm, without_turret
from sim.clearance import ClearanceModel
from sim.effects.structure import StandInTurret, params_with_stand_in
from sim.frames import Workspace
from sim.initialisation import initialise_joints
from sim.loop import ClosedLoop, Setup
from sim.pose_sequence import describe_no_way, free_air_loop, pose_in_workspace, run_and_rest
from sim.sequence import Outcome
from sim.tracker import TYPICAL_TRACKER, Tracker, turret_pose
from sim.world import World
from simgap.common.errors import BadRequest, UserError
from simgap.common.progress import Progress

SHOULDER_IN_SHARE: Final = 0.3
"""Share of poses with the shoulder-in branches."""
MIN_CLEARANCE_M: Final = 0.01
SHOULDER_OUT_BRANCHES, SHOULDER_IN_BRANCHES = BRANCHES[:4], BRANCHES[4:]


@dataclass(frozen=True, slots=True)
class PoseGroup:
    """Part of a campaign: mounted turret, tilt of the rover, and number of poses."""

    turret_kg: float | None
    """Mass of the stand-in turret; None for the arm's own turret."""
    roll_rad: float
    count: int

    def params(self, params: Params) -> Params:
        """Return the parameters of flight software for this turret."""
        return params_with_stand_in(params, self.turret_kg)


PAPER_GROUPS: Final = tuple(
    PoseGroup(kg, float(np.radians(roll_deg)), 40) for roll_deg in (0.0, 20.0) for kg in (8.0, 19.0)
)
"""Groups of the paper: two stand-in turrets on level ground, then both with the rover rolled by 20 deg."""


def resize_groups(groups: tuple[PoseGroup, ...], poses: int) -> tuple[PoseGroup, ...]:
    """Return the same groups with this number of poses in all."""
    share, rest = divmod(poses, len(groups))
    return tuple(PoseGroup(g.turret_kg, g.roll_rad, share + (k < rest)) for k, g in enumerate(groups))


def group_poses(arm: BuiltArm, group: PoseGroup, scene: World, rng: np.random.Generator) -> list[Array]:
    """Draw the collision-free poses of one group.

    Args:
        arm: Arm with its flight parameters.
        group: Turret, tilt and number of poses.
        scene: World whose terrain the arm must clear.

    Returns:
        Joint angles [rad] of each pose, shape (5,), ordered for short moves from the ready pose.
    """
    config = configure(group.params(arm.params))
    space = ClearanceModel(config.params, scene, arm.model)
    inside = round(SHOULDER_IN_SHARE * group.count)
    branches = [SHOULDER_IN_BRANCHES] * inside + [SHOULDER_OUT_BRANCHES] * (group.count - inside)
    goals = [_clear_pose(config, space, rng, names, arm.model.workspace) for names in branches]
    return order_by_time(config, np.array(config.params.poses.ready_rad), goals)


def _clear_pose(
    config: Config,
    space: ClearanceModel,
    rng: np.random.Generator,
    names: tuple[str, ...],
    workspace: Workspace,
) -> Array:
    while True:
        pose = pose_in_workspace(config, rng, config.farthest_tool, names, workspace)
        clearance = space.clearance(pose[:, None])
        if min(clearance.outside_m, clearance.self_m) > MIN_CLEARANCE_M:
            return pose


def order_by_time(config: Config, start_rad: Array, goals: list[Array]) -> list[Array]:
    """Order poses so that the next one is always the pose that is reached soonest.

    Args:
        config: Configuration with the joint speeds.
        start_rad: Joint angles at the start, shape (5,).
        goals: Joint angles [rad] of each pose, shape (5,).

    Returns:
        The poses in order.
    """
    remaining, ordered, here = list(goals), [], start_rad
    while remaining:
        time_s = [float(np.max(np.abs(goal - here) / config.speed_rad_s)) for goal in remaining]
        here = remaining.pop(int(np.argmin(time_s)))
        ordered.append(here)
    return ordered


def branch_name(config: Config, output_rad: Array) -> str:
    """Return the name of the inverse-kinematics branch of a pose.

    Args:
        config: Configuration with the arm.
        output_rad: Joint angles, shape (5,).

    Returns:
        The name of the branch.
    """
    return BRANCHES[
        int(branch_index(fold_distances(config.arm.orthogonal[config.farthest_tool], output_rad)))
    ]


class CampaignFailed(UserError):
    """Error: the arm could not be initialised, or a move failed."""

    exit_status = 3


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """Groups of poses, tracker and seed of a campaign."""

    groups: tuple[PoseGroup, ...] = PAPER_GROUPS
    tracker: Tracker = TYPICAL_TRACKER
    seed: int = 0


def earth_reference(arm: BuiltArm, progress: Progress) -> Reference:
    """Find the hardstop of every joint on Earth without a turret.

    Loads imitate those on Mars with the turret.

    Raises:
        CampaignFailed: A hardstop was not found.
        BadRequest: The arm has no poses whose loads on Earth without a turret equal those on Mars.
    """
    try:
        bare = without_turret(arm, on_earth=True)
    except NoPlan as error:
        raise BadRequest(f"arm: no poses for Earth without a turret: {error}") from error
    runs = []
    for run in initialise_joints(bare, World("earth")):
        runs.append(run)
        progress(len(runs), len(HARDSTOP_ORDER), "hardstops")
    if runs[-1].outcome is not Outcome.DONE:
        raise CampaignFailed(f"{arm.name} was not initialised: {runs[-1].evrs[-1][1].message}")
    return runs[-1].reference


def run_campaign(arm: BuiltArm, reference: Reference, plan: CampaignPlan, progress: Progress) -> Campaign:
    """Run every pose of a plan in the closed loop.

    Raises:
        CampaignFailed: A move failed.
    """
    total, rows = sum(group.count for group in plan.groups), []
    for k in range(len(plan.groups)):
        for row in group_rows(arm, reference, plan, k):
            rows.append(row)
            progress(len(rows), total, "poses")
    return stack_rows(arm.name, rows)


def group_rows(arm: BuiltArm, reference: Reference, plan: CampaignPlan, k: int) -> Iterator[CampaignRow]:
    """Run the poses of one group; leave out poses at which the tracker sees too few targets."""
    group = plan.groups[k]
    world = World("earth", tilt_roll_rad=group.roll_rad)
    goals = group_poses(arm, group, World("earth"), np.random.default_rng([plan.seed, k, 0]))
    rng = np.random.default_rng([plan.seed, k, 1])
    turret = () if group.turret_kg is None else (StandInTurret(group.turret_kg),)
    known = replace(arm, params=group.params(arm.params))
    setup = Setup(known, world, known.params.poses.ready_rad, plan.seed, reference, turret)
    loop = free_air_loop(setup)  # people checked the paths between poses for collisions
    for goal in goals:
        problem = run_and_rest(loop, MoveJoints(joints5(goal), "on"))
        if problem is not None:
            raise CampaignFailed(describe_no_way(arm, goal, problem))
        try:
            yield _row(loop, group, k, plan.tracker, rng)
        except TooFewTargets:
            continue


def _row(
    loop: ClosedLoop, group: PoseGroup, k: int, tracker: Tracker, rng: np.random.Generator
) -> CampaignRow:
    loop.plant.truth()  # updates the kinematics of the plant
    measurement = measure_pose(tracker, loop.plant, group.roll_rad, turret_pose(loop.plant), rng)
    joints, arm = loop.state.joints, loop.config.arm
    gear = joints.gear_rad[:, LIKELY]
    backlash_rad = clip_to_backlash(joints.reference.half_backlash_rad, gear)
    return CampaignRow(
        group=k,
        branch=branch_name(loop.config, joints.output_rad),
        motor_rad=joints.motor_rad,
        backlash_rad=backlash_rad,
        friction_Nm=loop.state.load.torque_Nm - arm.gear_stiffness_Nm_rad * (gear - backlash_rad),
        side=joints.side,
        gravity_R_m_s2=joints.gravity_R_m_s2,
        turret_kg=np.nan if group.turret_kg is None else group.turret_kg,
        measurement=measurement,
    )

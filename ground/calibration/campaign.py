"""The campaign in the closed loop: hardstops first, then flight software goes to every pose."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import HARDSTOP_ORDER
from fsw.dictionary.types import joints5
from fsw.estimate.gear import LIKELY, clip_to_backlash
from fsw.estimate.reference import Reference
from ground.calibration.data import Campaign
from ground.calibration.frames import FewTargets
from ground.calibration.poses import PAPER_GROUPS, Group, branch_name, group_poses
from ground.calibration.survey import Row, campaign_from, surveyed
from ground.common.progress import Progress
from sim.arms import BuiltArm
from sim.effects.structure import StandInTurret
from sim.hardstop_loads import without_turret
from sim.initialisation import initialise_joints
from sim.loop import ClosedLoop, Setup
from sim.pose_sequence import free_air_loop, run_and_rest
from sim.sequence import Outcome
from sim.tracker import TYPICAL_TRACKER, Tracker, turret_pose
from sim.world import World


class CampaignFailed(RuntimeError):
    """The arm could not be initialised, or a move did not come to its end."""


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """What is done, and with what."""

    groups: tuple[Group, ...] = PAPER_GROUPS
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
    return campaign_from(arm.name, rows)


def group_rows(arm: BuiltArm, reference: Reference, plan: CampaignPlan, k: int) -> Iterator[Row]:
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
        except FewTargets:
            continue


def _row(loop: ClosedLoop, group: Group, k: int, tracker: Tracker, rng: np.random.Generator) -> Row:
    loop.plant.truth()  # brings the kinematics up to date
    seen = surveyed(tracker, loop.plant, group.roll_rad, turret_pose(loop.plant), rng)
    joints, arm = loop.state.joints, loop.config.arm
    gear = joints.gear_rad[:, LIKELY]
    gap = clip_to_backlash(joints.reference.half_gap_rad, gear)
    return Row(
        group=k,
        branch=branch_name(loop.config, joints.output_rad),
        motor_rad=joints.motor_rad,
        gap_rad=gap,
        held_Nm=loop.state.load.torque_Nm - arm.gear_stiffness_Nm_rad * (gear - gap),
        side=joints.side,
        gravity_R_m_s2=joints.gravity_R_m_s2,
        turret_kg=np.nan if group.turret_kg is None else group.turret_kg,
        seen=seen,
    )

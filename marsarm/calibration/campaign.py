"""Calibration campaign in the closed loop: find the hardstops, then move to every pose and measure it.

Poses are joint angles [rad], (5,).
"""

from collections.abc import Iterator, Sequence
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
from fsw.kinematics.transforms import Array, Pose, adjoint, inverse, record_arrays, skew, stack_poses
from marsarm.calibration.campaign_data import BelievedPoses, Campaign, MeasuredPoses
from sim.arm_check import NoPlan, without_turret
from sim.arms import BuiltArm
from sim.clearance import ClearanceModel
from sim.effects.structure import StandInTurret, params_with_stand_in
from sim.frames import P_NR_M
from sim.initialisation import initialise_joints
from sim.loop import ClosedLoop, Setup
from sim.plant import Plant
from sim.pose_sequence import describe_no_way, free_air_loop, pose_in_workspace, run_and_rest
from sim.sequence import Outcome
from sim.setting import World
from sim.tracker import (
    GROUND_TARGETS,
    ROVER_TARGETS,
    TURRET_TARGETS,
    TYPICAL_TRACKER,
    TargetReadings,
    Tracker,
    TrackerTargets,
    measure_targets,
    rover_pose,
    turret_pose,
)
from simgap.common.errors import BadRequest, UserError
from simgap.common.progress import Progress

MIN_TARGETS: Final = 3
"""Smallest number of targets that defines a frame; they must not be on one line."""
COLLINEARITY: Final = 1e-3
"""Targets count as collinear if they are this close to a line, as a share of their spread."""
X_NR: Final = Pose(np.eye(3), P_NR_M)
SWAY_RAD, SWAY_M = 2e-4, 1e-3
"""Motion of the rover on its suspension from pose to pose, one sigma an axis; assumed."""


class TooFewTargets(ValueError):
    """Error: too few targets were seen to define a frame."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameFit:
    """Pose of a body from its targets."""

    X_WB: Pose
    covariance: Array
    """Covariance of the screw from true to measured pose, in body axes, rotation first, (6, 6)."""
    misfit: Array
    """Measured less fitted target positions, in units of their noise, shape (3, k)."""
    count: int


def fit_frame(targets: TrackerTargets, shots: TargetReadings, name: str) -> FrameFit:
    """Fit a body's frame in the tracker's to visible targets (Kabsch); TooFewTargets if they are no frame."""
    seen = shots.visible
    b, q, weight = targets.p_BoQ_B_m[:, seen], shots.p_WoQ_W_m[:, seen], shots.sigma_m[seen] ** -2
    count = int(np.count_nonzero(seen))
    if count < MIN_TARGETS:
        raise TooFewTargets(
            f"{name}: {count} targets seen; {MIN_TARGETS} that are not on one line are the least"
        )
    mid_b, mid_q = (np.average(p, axis=1, weights=weight) for p in (b, q))
    b_about, q_about = b - mid_b[:, None], q - mid_q[:, None]
    spread = np.linalg.svd(b_about * np.sqrt(weight), compute_uv=False)
    if spread[1] < COLLINEARITY * spread[0]:
        raise TooFewTargets(f"{name}: the {count} targets seen are on one line; one beside it is needed")
    U, _, Vt = np.linalg.svd((q_about * weight) @ b_about.T)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    p = mid_q - R @ mid_b
    A = np.concatenate([-skew(b), np.repeat(np.eye(3)[:, :, None], count, axis=2)], axis=1)
    information = np.einsum("ijk,ilk,k->jl", A, A, weight)
    misfit = (q - (R @ b + p[:, None])) * np.sqrt(weight)
    return FrameFit(Pose(R, p), np.linalg.inv(information), misfit, count)


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """Measured turret pose in the rover, with the quality of the measurement."""

    X_RT: Pose
    covariance: Array
    """In axes of T, rotation first, (6, 6)."""
    targets_seen: tuple[int, int, int]
    misfit_m: float
    X_WG: Pose
    """Frame of the ground targets in the tracker's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class CampaignRow:
    """One pose: state known to flight software and measurement."""

    group: int
    branch: str
    believed: BelievedPoses
    """State at this pose alone, without the axis of the poses."""
    measurement: PoseMeasurement


def measure_pose(
    tracker: Tracker, plant: Plant, roll_rad: float, X_RF: Pose, rng: np.random.Generator
) -> PoseMeasurement:
    """Measure the arm at rest, while the rover sways; TooFewTargets if the tracker sees too few on a body."""
    sway = rng.standard_normal(6) * np.repeat([SWAY_RAD, SWAY_M], 3)
    readings = measure_targets(tracker, plant, rover_pose(roll_rad, sway), X_RF, rng)
    named = zip(
        (GROUND_TARGETS, ROVER_TARGETS, TURRET_TARGETS), readings, ("ground", "rover", "turret"), strict=True
    )
    ground, rover, turret = (fit_frame(targets, shot, name) for targets, shot, name in named)
    X_NT = inverse(rover.X_WB) @ turret.X_WB  # the rover's targets are known in RNAV; its own motion cancels
    from_N = adjoint(inverse(X_NT))
    covariance = turret.covariance + from_N @ rover.covariance @ from_N.T
    frames = (ground, rover, turret)
    sigma_m = [shot.sigma_m[shot.visible] for shot in readings]
    squares = sum(float(np.sum((f.misfit * s) ** 2)) for f, s in zip(frames, sigma_m, strict=True))
    counts = (ground.count, rover.count, turret.count)
    misfit = float(np.sqrt(squares / max(3 * sum(counts) - 18, 1)))  # six numbers are fitted for each frame
    return PoseMeasurement(inverse(X_NR) @ X_NT, covariance, counts, misfit, ground.X_WB)


def stack_rows(arm_name: str, rows: Sequence[CampaignRow]) -> Campaign:
    """Stack rows into a campaign."""
    values = zip(*(record_arrays(row.believed) for row in rows), strict=True)
    believed = BelievedPoses(*(np.stack(of_all, axis=-1) for of_all in values))
    ground = np.stack([row.measurement.X_WG.p for row in rows], -1)
    return Campaign(
        arm_name=arm_name,
        group=np.array([row.group for row in rows]),
        branch=tuple(row.branch for row in rows),
        believed=believed,
        measured=MeasuredPoses(
            stack_poses([row.measurement.X_RT for row in rows]),
            np.stack([row.measurement.covariance for row in rows]),
        ),
        targets_seen=np.array([row.measurement.targets_seen for row in rows]).T,
        misfit_m=np.array([row.measurement.misfit_m for row in rows]),
        tracker_moved_m=np.linalg.norm(ground - ground[:, :1], axis=0),
    )


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
    """Draw the poses of one group, clear of the terrain, in an order of short moves."""
    config = configure(group.params(arm.params))
    space = ClearanceModel(config.params, scene, arm.model)
    inside = round(SHOULDER_IN_SHARE * group.count)
    branches = [SHOULDER_IN_BRANCHES] * inside + [SHOULDER_OUT_BRANCHES] * (group.count - inside)
    goals: list[Array] = []
    while len(goals) < len(branches):
        names = branches[len(goals)]
        pose = pose_in_workspace(config, rng, config.farthest_tool, names, arm.model.workspace)
        clearance = space.clearance(pose[:, None])
        if min(clearance.outside_m, clearance.self_m) > MIN_CLEARANCE_M:
            goals.append(pose)
    return order_by_time(config, np.array(config.params.poses.ready_rad), goals)


def order_by_time(config: Config, start_rad: Array, goals: list[Array]) -> list[Array]:
    """Order poses so that the next one is always that which is reached soonest."""
    remaining, ordered, here = list(goals), [], start_rad
    while remaining:
        time_s = [float(np.max(np.abs(goal - here) / config.speed_rad_s)) for goal in remaining]
        here = remaining.pop(int(np.argmin(time_s)))
        ordered.append(here)
    return ordered


def branch_name(config: Config, output_rad: Array) -> str:
    """Return the name of the inverse-kinematics branch of a pose."""
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
    """Find the hardstop of every joint on Earth without a turret, with loads like those on Mars with it.

    CampaignFailed says that one was not found, BadRequest that no poses of the arm have such loads.
    """
    try:
        bare = without_turret(arm, on_earth=True)
    except NoPlan as error:
        raise BadRequest(f"arm: no poses for Earth without a turret: {error}") from error
    runs = []
    progress(0, len(HARDSTOP_ORDER), "hardstops")
    for run in initialise_joints(bare, World("earth")):
        runs.append(run)
        progress(len(runs), len(HARDSTOP_ORDER), "hardstops")
    if runs[-1].outcome is not Outcome.DONE:
        raise CampaignFailed(f"{arm.name} was not initialised: {runs[-1].evrs[-1][1].message}")
    return runs[-1].reference


def run_campaign(arm: BuiltArm, reference: Reference, plan: CampaignPlan, progress: Progress) -> Campaign:
    """Run every pose of a plan in the closed loop; CampaignFailed if a move failed."""
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
    believed = BelievedPoses(
        motor_rad=joints.motor_rad,
        backlash_rad=backlash_rad,
        friction_Nm=loop.state.load.torque_Nm - arm.gear_stiffness_Nm_rad * (gear - backlash_rad),
        side=joints.side,
        gravity_R_m_s2=joints.gravity_R_m_s2,
        turret_kg=np.array(np.nan if group.turret_kg is None else group.turret_kg),
    )
    return CampaignRow(k, branch_name(loop.config, joints.output_rad), believed, measurement)

"""Verification of a calibrated arm in the closed loop.

The arm finds its hardstops again and moves the full turret to fresh targets on Earth, Mars and cold Mars.
In all functions, `motor_error_rad` are true less believed motor angles, (5,).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import MoveTool
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.dictionary.types import vector3
from fsw.estimate.gear import load_error
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.statics import settle, settle_output
from fsw.kinematics.transforms import Array, Pose, angle_between, screw_exp
from fsw.motion.plan import final_direction
from marsarm.calibration.arm_parameters import FIXTURE_M, FIXTURE_RAD
from marsarm.calibration.calibrate import Calibration
from marsarm.calibration.campaign import (
    CampaignFailed,
    CampaignPlan,
    CampaignRow,
    PoseGroup,
    TooFewTargets,
    branch_name,
    earth_reference,
    group_poses,
    measure_pose,
    stack_rows,
)
from marsarm.calibration.campaign_data import BelievedPoses, Campaign, MeasuredPoses
from marsarm.calibration.residual_model import group_by_turret, reorder_poses, residual_model
from sim.arms import BuiltArm
from sim.clearance import ClearanceModel
from sim.effects.effect import params_with_effects
from sim.effects.environment import Ambient
from sim.effects.joints import HardstopAngle
from sim.effects.structure import params_with_stand_in
from sim.frames import Workspace, approach_from, p_R_from_N, random_targets
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.plant import Plant
from sim.pose_sequence import free_air_loop, run_and_rest
from sim.setting import World
from sim.tracker import Tracker
from simgap.common.progress import Progress, part_of

SLIP_BAND: Final = 0.4
"""Band about the friction, as a share of it, in which an output may slip from its dragged position."""
MIN_DATA_SHARE: Final = 0.5
"""Smallest share of the knowledge of a combination that comes from data, not from the prior."""


def simulate_campaign(arm: BuiltArm, plan: CampaignPlan) -> Campaign:
    """Simulate a campaign by static equilibria; leave out poses at which the tracker sees too few targets."""
    rows = []
    for k, group in enumerate(plan.groups):
        rng = np.random.default_rng([plan.seed, k, 2])
        goals = group_poses(arm, group, World("earth"), rng)
        scene = _scene(arm, plan, k)
        rows += [row for goal in goals if (row := _settle_row(scene, goal, rng)) is not None]
    return stack_rows(arm.name, rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Common data of the poses of one group."""

    k: int
    group: PoseGroup
    known: Config
    true: Config
    hardstop_error_rad: Array
    """Errors of the hardstop angles, shape (5,)."""
    gravity_R_m_s2: Array
    plant: Plant
    """Plant that shows the arm to the tracker."""
    tracker: Tracker


def _scene(arm: BuiltArm, plan: CampaignPlan, k: int) -> _Scene:
    group = plan.groups[k]
    known = group.params(arm.params)
    return _Scene(
        k=k,
        group=group,
        known=configure(known),
        true=configure(group.params(true_params(arm))),
        hardstop_error_rad=hardstop_errors_rad(arm),
        gravity_R_m_s2=World("earth", tilt_roll_rad=group.roll_rad).gravity_N_m_s2,
        plant=ClearanceModel(known, World("earth"), arm.model).plant,
        tracker=plan.tracker,
    )


def _settle_row(scene: _Scene, goal: Array, rng: np.random.Generator) -> CampaignRow | None:
    group, known, gravity = scene.group, scene.known, scene.gravity_R_m_s2
    load = settle_output(known.arm, goal, gravity).torque_Nm
    dragged = final_direction(known, load, gravity)
    friction_Nm = known.output_friction_Nm * np.where(
        dragged == 0, rng.choice([-1.0, 1.0], len(Joint)), dragged
    )
    is_certain = np.abs(np.abs(load) - known.output_friction_Nm) > load_error(known, gravity)
    side = np.where(load > friction_Nm, 1.0, -1.0)
    slips = ~is_certain & (np.abs(np.abs(load) / known.output_friction_Nm - 1.0) < SLIP_BAND)
    position = np.where(~slips, side, rng.uniform(-1.0, 1.0, len(Joint)))
    pulled = friction_Nm / scene.true.arm.gear_stiffness_Nm_rad
    found = settle(scene.true.arm, goal, position * scene.true.half_backlash_rad - pulled, gravity)
    scene.plant.show(found.output_rad, found.strain)
    try:
        measurement = measure_pose(scene.tracker, scene.plant, group.roll_rad, found.frames.X_RF[5], rng)
    except TooFewTargets:
        return None
    believed = BelievedPoses(
        motor_rad=goal - scene.hardstop_error_rad,
        backlash_rad=side * known.half_backlash_rad,
        friction_Nm=friction_Nm,
        side=np.where(is_certain, side, 0.0),
        gravity_R_m_s2=gravity,
        turret_kg=np.array(np.nan if group.turret_kg is None else group.turret_kg),
    )
    return CampaignRow(scene.k, branch_name(known, found.output_rad), believed, measurement)


def true_params(arm: BuiltArm) -> Params:
    """Return the parameters that include every effect of the arm; hidden from flight software."""
    return params_with_effects(arm.effects, arm.params)


def hardstop_errors_rad(arm: BuiltArm) -> Array:
    """Compute true less nominal hardstop angles, (5,) [rad]; the arm's encoders read this much too little."""
    error_rad = np.zeros(len(Joint))
    for effect in arm.effects:
        if isinstance(effect, HardstopAngle):
            error_rad[effect.joint] += effect.shift_rad
    return error_rad


def zero_errors_rad(arm: BuiltArm, reference: Reference) -> Array:
    """Compute true less believed motor angles, (5,) [rad], after an initialisation."""
    error_rad: Array = true_reference(arm).zero_rad + hardstop_errors_rad(arm) - reference.zero_rad
    return error_rad


def true_poses(arm: BuiltArm, believed: BelievedPoses, motor_error_rad: Array) -> Pose:
    """Compute X_RT, batch (n,), of the true arm at the believed positions in the backlash."""
    params = true_params(arm)
    half = configure(params).half_backlash_rad[:, None]
    motor = believed.motor_rad + motor_error_rad[:, None]
    parts = []
    for turret_kg, where in group_by_turret(believed):
        truth = build_arm(params_with_stand_in(params, turret_kg))
        at = believed.at(where)
        backlash_rad = np.sign(at.backlash_rad) * half - at.friction_Nm / truth.gear_stiffness_Nm_rad[:, None]
        parts.append((where, settle(truth, motor[:, where], backlash_rad, at.gravity_R_m_s2).frames.X_RF[5]))
    return reorder_poses(parts, believed.motor_rad.shape[1])


def compare_with_truth(arm: BuiltArm, found: Calibration, motor_error_rad: Array) -> tuple[Array, Array]:
    """Compare the calibrated arm with the true arm; the frame Tool of the targets is taken as nominal.

    Returns:
        Screws from calibrated to true poses, at the believed positions in the backlash, shape (6, n). The
        error along each combination that the data determine better than the prior, over its stated sigma.
    """
    fitted = residual_model(found.nominal, found.campaign, found.preliminary)
    truth = MeasuredPoses(
        true_poses(arm, found.campaign.believed, motor_error_rad), found.campaign.measured.covariance
    )
    model = replace(fitted, measured=truth)
    at_best = model(found.best.values)
    J = at_best.jacobian[found.best.used].reshape(-1, found.best.values.size)
    share, along = np.linalg.eigh(J @ found.best.covariance @ J.T)
    determined = share > MIN_DATA_SHARE
    error = along[:, determined].T @ at_best.residual[found.best.used].ravel()
    return model.errors(found.best.values), error / np.sqrt(share[determined])


COLD_C: Final = -35.0
"""Temperature of actuators and arm on cold Mars, the coldest in flight."""
MOST_TRIES: Final = 20


def register_tools(arm: BuiltArm, seed: int) -> dict[str, Pose]:
    """Simulate the measurement of the frame X_FT of every tool by targets on it and on the interface."""
    rng = np.random.default_rng([seed, 3])
    truth = build_arm(true_params(arm))
    noise = np.repeat([FIXTURE_RAD, FIXTURE_M], 3)
    return {
        tool: truth.X_FT[tool] @ screw_exp(noise * rng.standard_normal(6)) for tool in arm.params.tool_names
    }


WORLDS: Final = 3
"""Environments of a verification: Earth, Mars and cold Mars."""
HARDSTOP_TARGETS: Final = 10
"""Number of targets that last as long as the hardstops of all joints, for the progress."""


@dataclass(frozen=True, slots=True)
class PlaceErrors:
    """Tool errors at the targets of one environment."""

    rms_m: float
    max_m: float
    max_lateral_m: float
    max_axis_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """Result of a verification."""

    zero_rad: Array
    """Encoder zeros with the new parameters less those with the old parameters, shape (5,)."""
    expected_rad: Array
    """Change of the hardstop angles, shape (5,)."""
    places: Mapping[str, PlaceErrors]


def verify_calibration(
    arm: BuiltArm, params: Params, targets: int, seed: int, progress: Progress
) -> Verification:
    """Move to fresh targets on Earth, Mars, and cold Mars with a shrunken arm; CampaignFailed if it fails."""
    known = replace(arm, params=params)
    stops = 2 * HARDSTOP_TARGETS
    share = stops / (stops + WORLDS * targets)
    before = earth_reference(arm, part_of(progress, 0.0, 0.5 * share))
    reference = earth_reference(known, part_of(progress, 0.5 * share, share))
    moving = part_of(progress, share, 1.0)
    changed_rad = configure(params).hardstop_rad - configure(arm.params).hardstop_rad
    cold = (Ambient(COLD_C),)
    where = (("earth", World("earth"), ()), ("mars", World(), ()), ("cold mars", World(), cold))
    places = {}
    for k, (name, world, effects) in enumerate(where):
        loop = free_air_loop(Setup(known, world, params.poses.ready_rad, seed, reference, effects))
        rng, found = np.random.default_rng([seed, 4]), list[Array]()
        while len(found) < targets:
            tool = loop.plant.tools[len(found) % len(loop.plant.tools)]
            found.append(_visit_target(loop, tool, arm.model.workspace, rng))
            moving(k * targets + len(found), len(where) * targets, name)
        rms_m = float(np.sqrt(np.mean(np.array(found)[:, 0] ** 2)))
        places[name] = PlaceErrors(rms_m, *np.max(found, axis=0).tolist())
    return Verification(reference.zero_rad - before.zero_rad, changed_rad, places)


def _visit_target(loop: ClosedLoop, tool: str, workspace: Workspace, rng: np.random.Generator) -> Array:
    """Move a tool to a target; return its errors: total, lateral [m], and axis [rad]; shape (3,)."""
    for _ in range(MOST_TRIES):
        p_N_m, angles = random_targets(rng, 1, workspace)
        target, approach = p_R_from_N(p_N_m[:, 0]), approach_from(angles)[:, 0]
        problem = run_and_rest(loop, MoveTool(tool, vector3(target), vector3(approach)))
        if problem is None:
            truth, index = loop.truth(), loop.plant.tools.index(tool)
            miss, axis = truth.p_RoTo_R_m[index] - target, truth.R_RT[index][:, 0]
            lateral_m = np.linalg.norm(miss - (miss @ approach) * approach)
            return np.array([np.linalg.norm(miss), lateral_m, angle_between(axis, approach)])
    raise CampaignFailed(f"no target in {MOST_TRIES} could be reached: {problem}")

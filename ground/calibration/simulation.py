"""What a calibration says beside what is true: for judging simulated campaigns only."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params
from fsw.estimate.gear import load_error
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.statics import settle, settle_output
from fsw.kinematics.transforms import Array, Pose
from fsw.motion.compensation import final_direction
from ground.calibration.arm_model import arm_model, group_by_turret, reorder_poses
from ground.calibration.calibrate import Calibration
from ground.calibration.campaign import CampaignPlan, PoseGroup, branch_name, group_poses
from ground.calibration.campaign_data import BelievedPoses, Campaign
from ground.calibration.screws import MeasuredPoses
from ground.calibration.survey import CampaignRow, TooFewTargets, measure_pose, stack_rows
from sim.arms import BuiltArm
from sim.clearance import ClearanceModel
from sim.effects.effect import params_with_effects
from sim.effects.joints import HardstopAngle
from sim.effects.structure import params_with_stand_in
from sim.initialisation import true_reference
from sim.plant import Plant
from sim.tracker import Tracker
from sim.world import World

SLIP_BAND: Final = 0.4
"""A load that is so near the friction, as a share, lets an output slip from where it was dragged to."""


def simulate_campaign(arm: BuiltArm, plan: CampaignPlan) -> Campaign:
    """Every pose of the plan that the tracker can see."""
    rows = []
    for k, group in enumerate(plan.groups):
        rng = np.random.default_rng([plan.seed, k, 2])
        goals = group_poses(arm.params, group, World("earth"), rng)
        scene = _scene(arm, plan, k)
        rows += [row for goal in goals if (row := _settle_row(scene, goal, rng)) is not None]
    return stack_rows(arm.name, rows)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What the poses of one group have in common."""

    k: int
    group: PoseGroup
    known: Config
    true: Config
    off_rad: Array
    """Of the hardstops, (5,)."""
    gravity_R_m_s2: Array
    plant: Plant
    """Shows the arm to the tracker."""
    tracker: Tracker


def _scene(arm: BuiltArm, plan: CampaignPlan, k: int) -> _Scene:
    group = plan.groups[k]
    known = group.params(arm.params)
    return _Scene(
        k=k,
        group=group,
        known=configure(known),
        true=configure(group.params(true_params(arm))),
        off_rad=hardstop_errors_rad(arm),
        gravity_R_m_s2=World("earth", tilt_roll_rad=group.roll_rad).gravity_N_m_s2,
        plant=ClearanceModel(known, World("earth")).plant,
        tracker=plan.tracker,
    )


def _settle_row(scene: _Scene, goal: Array, rng: np.random.Generator) -> CampaignRow | None:
    group, known, gravity = scene.group, scene.known, scene.gravity_R_m_s2
    load = settle_output(known.arm, goal, gravity).torque_Nm
    dragged = final_direction(known, load, gravity)
    held = known.output_friction_Nm * np.where(dragged == 0, rng.choice([-1.0, 1.0], len(Joint)), dragged)
    sure = np.abs(np.abs(load) - known.output_friction_Nm) > load_error(known, gravity)
    side = np.where(load > held, 1.0, -1.0)
    slips = ~sure & (np.abs(np.abs(load) / known.output_friction_Nm - 1.0) < SLIP_BAND)
    lies = np.where(~slips, side, rng.uniform(-1.0, 1.0, len(Joint)))
    pulled = held / scene.true.arm.gear_stiffness_Nm_rad
    found = settle(scene.true.arm, goal, lies * scene.true.half_gap_rad - pulled, gravity)
    scene.plant.show(found.output_rad, found.strain)
    try:
        seen = measure_pose(scene.tracker, scene.plant, group.roll_rad, found.frames.X_RF[5], rng)
    except TooFewTargets:
        return None
    return CampaignRow(
        group=scene.k,
        branch=branch_name(known, found.output_rad),
        motor_rad=goal - scene.off_rad,
        backlash_rad=side * known.half_gap_rad,
        friction_Nm=held,
        side=np.where(sure, side, 0.0),
        gravity_R_m_s2=gravity,
        turret_kg=np.nan if group.turret_kg is None else group.turret_kg,
        measurement=seen,
    )


def true_params(arm: BuiltArm) -> Params:
    """The flight parameters that know every effect of the arm; not for flight software."""
    return params_with_effects(arm.effects, arm.params)


def hardstop_errors_rad(arm: BuiltArm) -> Array:
    """How far the arm's hardstops are from where they are drawn: its encoders read so much too little."""
    off = np.zeros(len(Joint))
    for effect in arm.effects:
        if isinstance(effect, HardstopAngle):
            off[effect.joint] += effect.shift_rad
    return off


MIN_DATA_SHARE: Final = 0.5
"""Of what is known of a combination, the data tell more than this share, the prior the rest."""


def zero_errors_rad(arm: BuiltArm, reference: Reference) -> Array:
    """By how much motors stand beyond where an initialisation has them, (5,)."""
    off_rad: Array = true_reference(arm).zero_rad + hardstop_errors_rad(arm) - reference.zero_rad
    return off_rad


def true_poses(arm: BuiltArm, believed: BelievedPoses, off_rad: Array) -> Pose:
    """Where the true arm's turret frame is at these motor angles, in the gaps where it is believed, (n,).

    `off_rad` (5,): by how much motors stand beyond where they are believed to.
    """
    params = true_params(arm)
    half = configure(params).half_gap_rad[:, None]
    motor = believed.motor_rad + off_rad[:, None]
    parts = []
    for turret_kg, where in group_by_turret(believed):
        truth = build_arm(params_with_stand_in(params, turret_kg))
        at = believed.at(where)
        gap = np.sign(at.backlash_rad) * half - at.friction_Nm / truth.gear_stiffness_Nm_rad[:, None]
        parts.append((where, settle(truth, motor[:, where], gap, at.gravity_R_m_s2).frames.X_RF[5]))
    return reorder_poses(parts, believed.motor_rad.shape[1])


@dataclass(frozen=True, slots=True, eq=False)
class TruthComparison:
    """How far the calibrated arm is from the true one."""

    error: Array
    """Screws from the calibrated poses to the true ones, in the gaps where they are believed, (6, n)."""
    sigmas: Array
    """The same along each combination of which the data tell more than the prior, over its stated sigma."""


def compare_with_truth(arm: BuiltArm, found: Calibration, off_rad: Array) -> TruthComparison:
    """The calibrated arm beside the true one, motors `off_rad` (5,) beyond where they are believed.

    The frame Tool, of the targets alone, is in truth as drawn.
    """
    fitted = arm_model(found.nominal, found.campaign, found.preliminary)
    truth = MeasuredPoses(
        true_poses(arm, found.campaign.believed, off_rad), found.campaign.measured.covariance
    )
    model = replace(fitted, measured=truth)
    at_best = model(found.best.values)
    J = at_best.jacobian[found.best.used].reshape(-1, found.best.values.size)
    share, along = np.linalg.eigh(J @ found.best.covariance @ J.T)
    told = share > MIN_DATA_SHARE
    off = along[:, told].T @ at_best.residual[found.best.used].ravel()
    return TruthComparison(model.errors(found.best.values), off / np.sqrt(share[told]))

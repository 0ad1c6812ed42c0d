"""Simulated campaigns from statics alone, and comparison of a calibration with the true simulated arm."""

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
from fsw.motion.plan import final_direction
from marsarm.calibration.arm_model import arm_model, group_by_turret, reorder_poses
from marsarm.calibration.calibrate import Calibration
from marsarm.calibration.campaign import CampaignPlan, PoseGroup, branch_name, group_poses
from marsarm.calibration.campaign_data import BelievedPoses, Campaign
from marsarm.calibration.measured_poses import MeasuredPoses
from marsarm.calibration.survey import CampaignRow, TooFewTargets, measure_pose, stack_rows
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
    return CampaignRow(
        group=scene.k,
        branch=branch_name(known, found.output_rad),
        motor_rad=goal - scene.hardstop_error_rad,
        backlash_rad=side * known.half_backlash_rad,
        friction_Nm=friction_Nm,
        side=np.where(is_certain, side, 0.0),
        gravity_R_m_s2=gravity,
        turret_kg=np.nan if group.turret_kg is None else group.turret_kg,
        measurement=measurement,
    )


def true_params(arm: BuiltArm) -> Params:
    """Return the parameters that include every effect of the arm; hidden from flight software."""
    return params_with_effects(arm.effects, arm.params)


def hardstop_errors_rad(arm: BuiltArm) -> Array:
    """Compute the errors of the arm's hardstop angles; its encoders read this much too little.

    Args:
        arm: Arm with its effects.

    Returns:
        True less nominal hardstop angles [rad], shape (5,).
    """
    error_rad = np.zeros(len(Joint))
    for effect in arm.effects:
        if isinstance(effect, HardstopAngle):
            error_rad[effect.joint] += effect.shift_rad
    return error_rad


def zero_errors_rad(arm: BuiltArm, reference: Reference) -> Array:
    """Compute the errors of the motor angles after an initialisation.

    Args:
        arm: Arm with its effects.
        reference: Result of the initialisation.

    Returns:
        True less believed motor angles [rad], shape (5,).
    """
    error_rad: Array = true_reference(arm).zero_rad + hardstop_errors_rad(arm) - reference.zero_rad
    return error_rad


def true_poses(arm: BuiltArm, believed: BelievedPoses, motor_error_rad: Array) -> Pose:
    """Compute the poses of the true arm, at the believed motor angles and positions in the backlash.

    Args:
        arm: Arm with its effects.
        believed: Believed state of the arm at each pose.
        motor_error_rad: True less believed motor angles, shape (5,).

    Returns:
        X_RT, the turret frame in the rover frame, batch (n,).
    """
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


@dataclass(frozen=True, slots=True, eq=False)
class TruthComparison:
    """Difference of the calibrated arm from the true arm."""

    error: Array
    """Screws from calibrated to true poses, at the believed positions in the backlash, shape (6, n)."""
    sigmas: Array
    """Error along each combination, over its stated sigma.

    Only combinations that the data determine better than the prior are included.
    """


def compare_with_truth(arm: BuiltArm, found: Calibration, motor_error_rad: Array) -> TruthComparison:
    """Compare the calibrated arm with the true arm.

    The frame Tool of the targets is taken as nominal.

    Args:
        arm: Arm with its effects.
        motor_error_rad: True less believed motor angles, shape (5,).

    Returns:
        Errors of poses, and of parameter combinations over their sigmas.
    """
    fitted = arm_model(found.nominal, found.campaign, found.preliminary)
    truth = MeasuredPoses(
        true_poses(arm, found.campaign.believed, motor_error_rad), found.campaign.measured.covariance
    )
    model = replace(fitted, measured=truth)
    at_best = model(found.best.values)
    J = at_best.jacobian[found.best.used].reshape(-1, found.best.values.size)
    share, along = np.linalg.eigh(J @ found.best.covariance @ J.T)
    determined = share > MIN_DATA_SHARE
    error = along[:, determined].T @ at_best.residual[found.best.used].ravel()
    return TruthComparison(model.errors(found.best.values), error / np.sqrt(share[determined]))

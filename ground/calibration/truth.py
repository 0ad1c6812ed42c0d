"""What a calibration says beside what is true: for judging simulated campaigns only."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.statics import settle
from fsw.kinematics.transforms import Array, Pose
from ground.calibration.arm_model import arm_model, in_order, turrets
from ground.calibration.calibrate import Calibration
from ground.calibration.data import Believed
from ground.calibration.screws import Measured
from ground.calibration.settled import stops_off, true_params
from sim.arms import BuiltArm
from sim.effects.structure import params_with_stand_in
from sim.initialisation import true_reference

TOLD: Final = 0.5
"""Of what is known of a combination, the data tell more than this share, the prior the rest."""


def zeros_off(arm: BuiltArm, reference: Reference) -> Array:
    """By how much motors stand beyond where an initialisation has them, (5,)."""
    off_rad: Array = true_reference(arm).zero_rad + stops_off(arm) - reference.zero_rad
    return off_rad


def true_poses(arm: BuiltArm, believed: Believed, off_rad: Array) -> Pose:
    """Where the true arm's turret frame is at these motor angles, in the gaps where it is believed, (n,).

    `off_rad` (5,): by how much motors stand beyond where they are believed to.
    """
    params = true_params(arm)
    half = configure(params).half_gap_rad[:, None]
    motor = believed.motor_rad + off_rad[:, None]
    parts = []
    for turret_kg, where in turrets(believed):
        truth = build_arm(params_with_stand_in(params, turret_kg))
        at = believed.at(where)
        gap = np.sign(at.gap_rad) * half - at.held_Nm / truth.gear_stiffness_Nm_rad[:, None]
        parts.append((where, settle(truth, motor[:, where], gap, at.gravity_R_m_s2).frames.X_RF[5]))
    return in_order(parts, believed.motor_rad.shape[1])


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """How far the calibrated arm is from the true one."""

    error: Array
    """Screws from the calibrated poses to the true ones, in the gaps where they are believed, (6, n)."""
    sigmas: Array
    """The same along each combination of which the data tell more than the prior, over its stated sigma."""


def truth_beside(arm: BuiltArm, found: Calibration, off_rad: Array) -> Beside:
    """The calibrated arm beside the true one, motors `off_rad` (5,) beyond where they are believed.

    The frame Tool, of the targets alone, is in truth as drawn.
    """
    fitted = arm_model(found.nominal, found.campaign, found.near)
    truth = Measured(true_poses(arm, found.campaign.believed, off_rad), found.campaign.measured.covariance)
    model = replace(fitted, measured=truth)
    at_best = model(found.best.values)
    J = at_best.jacobian[found.best.used].reshape(-1, found.best.values.size)
    share, along = np.linalg.eigh(J @ found.best.covariance @ J.T)
    told = share > TOLD
    off = along[:, told].T @ at_best.residual[found.best.used].ravel()
    return Beside(model.errors(found.best.values), off / np.sqrt(share[told]))

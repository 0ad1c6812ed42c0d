"""What a calibration says beside what is true: for judging simulated campaigns only."""

from dataclasses import replace

import numpy as np

from fsw.kinematics.arm import arm_from
from fsw.kinematics.statics import settle
from fsw.kinematics.transforms import Array, Pose
from ground.calibration.arm_model import arm_model, turrets
from ground.calibration.calibrate import Calibration
from ground.calibration.data import Believed
from ground.calibration.screws import Measured
from ground.calibration.settled import stops_off, true_params
from sim.arms import BuiltArm
from sim.effects.turret import TurretMass


def true_poses(arm: BuiltArm, believed: Believed) -> Pose:
    """Where the true arm's turret frame is at these motor angles, in the gaps where it is believed, (n,)."""
    params = true_params(arm)
    half = np.array([0.5 * joint.backlash_rad for joint in params.joints.in_order()])[:, None]
    n = believed.motor_rad.shape[1]
    X = Pose(np.empty((3, 3, n)), np.empty((3, n)))
    motor = believed.motor_rad + stops_off(arm)[:, None]
    for turret_kg, where in turrets(believed):
        truth = arm_from(params if turret_kg is None else TurretMass(turret_kg).on_params(params))
        at = believed.at(where)
        gap = np.sign(at.gap_rad) * half - at.held_Nm / truth.gear_stiffness_Nm_rad[:, None]
        X_RF = settle(truth, motor[:, where], gap, at.gravity_R_m_s2).frames.X_RF
        X.R[:, :, where], X.p[:, where] = X_RF.R[:, :, 5], X_RF.p[:, 5]
    return X


def truth_beside(arm: BuiltArm, found: Calibration) -> tuple[Array, Array]:
    """Error screws (6, n) from the calibrated poses to those of the true arm, and their covariance (6n, 6n).

    Rows of the covariance are pose by pose. The frame Tool, of the targets alone, is in truth as drawn.
    """
    n = found.campaign.count
    plain = np.tile(np.eye(6), (n, 1, 1))
    truth = Measured(true_poses(arm, found.campaign.believed), plain)
    model = replace(arm_model(found.nominal, found.campaign), measured=truth, whitener=plain)
    at_best = model(found.best.values)
    J = at_best.jacobian.reshape(6 * n, -1)
    covariance: Array = J @ found.best.covariance @ J.T
    return at_best.residual.T, covariance

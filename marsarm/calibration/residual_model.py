"""Residuals of measured poses against the deflected arm, and their derivatives by the arm's parameters.

In all functions, `x` are values of the parameters, (p,), in the units of `arm_parameters`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.kinematics.arm import Arm, build_arm
from fsw.kinematics.statics import Equilibrium, settle
from fsw.kinematics.transforms import Array, Flags, Integers, Pose, screw_exp, skew
from marsarm.calibration.arm_parameters import (
    BACKLASHES,
    FRAME_SCREWS,
    GEAR_STIFFNESSES,
    JOINT_COUNT,
    LINK_STIFFNESSES,
    MASS_CENTRES,
    MASS_FACTORS,
    MASS_FRAMES,
    PARAMETER_COUNT,
    SCREW,
    STRAIN,
    DeflectionDerivatives,
    add_batch_axis,
    arm_with_values,
    differentiate_deflection,
    screw_derivatives,
    turret_displacement,
)
from marsarm.calibration.campaign_data import BelievedPoses, Campaign, MeasuredPoses
from marsarm.calibration.consensus import confirm_sides, pose_whitener
from sim.effects.structure import params_with_stand_in
from sim.tolerances import SPRING_FRAMES
from simgap import Fit, Linearisation, error_screw, linearise


@dataclass(frozen=True, slots=True, eq=False)
class CampaignResiduals:
    """Residual model of a campaign: whitened error screws as a function of the arm's parameters.

    Parameters are differences from the nominal arm, in the order of `arm_parameters`.
    """

    nominal: Params
    """Parameters of flight software from which the values differ."""
    believed: BelievedPoses
    measured: MeasuredPoses
    whitener: Array
    """Whitening matrices of the poses, shape (n, 6, 6)."""
    unknown: Flags
    """Outputs whose side of the backlash is unknown, shape (5, n)."""

    def __call__(self, x: Array) -> Linearisation:
        """Compute whitened error screws, (n, 6), and their derivatives, (n, 6, p)."""
        X, jacobian = _parameter_jacobian(settle_poses(self.nominal, x, self.believed), x)
        return linearise(X, jacobian, self.measured.X_RT, self.whitener)

    def errors(self, x: Array) -> Array:
        """Compute the screws from modelled to measured poses, (6, n) [rad, m], in modelled axes."""
        return error_screw(predict_poses(self.nominal, x, self.believed), self.measured.X_RT)


def residual_model(
    nominal: Params,
    campaign: Campaign,
    preliminary: Fit | None = None,
    with_backlash: bool = True,
    held_out: Flags | None = None,
) -> CampaignResiduals:
    """Build the residual model of a campaign.

    A preliminary fit decides which uncertain outputs lie where they are believed to lie. Outputs that it
    does not confirm carry no information about their joint.

    Args:
        preliminary: Fit close to the solution. Without it, all uncertain outputs count as unknown.
        with_backlash: If false, every output counts as resting on the side where it rests most often.
        held_out: Poses whose measurements must not decide any side, (n,).
    """
    believed, unknown = campaign.believed, campaign.believed.side == 0
    if not with_backlash:
        believed, unknown = _fix_sides(believed), np.zeros_like(unknown)
    x = np.zeros(PARAMETER_COUNT) if preliminary is None else preliminary.values
    parts = settle_poses(nominal, x, believed)
    output_jacobian = joint_jacobian(parts)
    if preliminary is not None:
        X, jacobian = _parameter_jacobian(parts, x)
        error = error_screw(X, campaign.measured.X_RT)
        uncertain = unknown if held_out is None else unknown & ~held_out
        agree = confirm_sides(
            campaign.measured,
            output_jacobian,
            error,
            jacobian,
            preliminary.covariance,
            uncertain,
            believed.backlash_rad,
        )
        unknown = unknown & ~agree
    return CampaignResiduals(
        nominal,
        believed,
        campaign.measured,
        pose_whitener(campaign.measured, output_jacobian, unknown),
        unknown,
    )


def _fix_sides(believed: BelievedPoses) -> BelievedPoses:
    """Put every output at one fixed position in its backlash.

    The choice does not affect a fit, because the encoder zeros absorb it.
    """
    half = np.abs(believed.backlash_rad).max(axis=1, keepdims=True)
    side = np.where(believed.backlash_rad.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return replace(believed, backlash_rad=np.broadcast_to(side * half, believed.backlash_rad.shape))


def group_by_turret(believed: BelievedPoses) -> list[tuple[float | None, Integers]]:
    """Group poses by the stand-in turret [kg], None for the arm's own; return the indices of each."""
    kinds = np.unique(believed.turret_kg)
    own = np.isnan(believed.turret_kg)
    found: list[tuple[float | None, Integers]] = [
        (float(kg), np.flatnonzero(believed.turret_kg == kg)) for kg in kinds if np.isfinite(kg)
    ]
    return [*found, *([(None, np.flatnonzero(own))] if own.any() else [])]


def predict_poses(nominal: Params, x: Array, believed: BelievedPoses) -> Pose:
    """Compute X_RT, the turret frame in the rover frame, batch (n,)."""
    return reorder_poses(
        ((part.where, part.X_RT) for part in settle_poses(nominal, x, believed)), believed.motor_rad.shape[1]
    )


def reorder_poses(parts: Iterable[tuple[Integers, Pose]], count: int) -> Pose:
    """Merge parts of a batch, with the indices of their poses, into one batch (count,)."""
    X = Pose(np.empty((3, 3, count)), np.empty((3, count)))
    for where, part in parts:
        X.R[:, :, where], X.p[:, where] = part.R, part.p
    return X


def _screw(x: Array, frame: Frame) -> Array:
    return x[6 * frame : 6 * frame + 6]


@dataclass(frozen=True, slots=True, eq=False)
class TurretPoses:
    """Static equilibria with one turret.

    The arm is mounted in frame D: the rover frame, displaced by the frame error of Arm1.
    """

    where: Integers
    """Indices of these poses in the campaign."""
    at: BelievedPoses
    stand_in: bool
    arm: Arm
    gravity_D_m_s2: Array
    rest: Equilibrium
    X_FT: Pose
    X_RT: Pose
    """Pose of the turret frame in the rover frame, batch (n,)."""

    def differentiate(self) -> DeflectionDerivatives:
        """Compute the derivatives of the deflection."""
        return differentiate_deflection(self.arm, self.rest, self.gravity_D_m_s2, self.X_FT)


def settle_poses(nominal: Params, x: Array, believed: BelievedPoses) -> list[TurretPoses]:
    """Compute the equilibria of all poses, a record for each turret."""
    parts, X_FT = [], screw_exp(_screw(x, Frame.TOOL))
    for turret_kg, where in group_by_turret(believed):
        at, stand_in = believed.at(where), turret_kg is not None
        arm, X_RD = arm_with_values(build_arm(params_with_stand_in(nominal, turret_kg)), x, stand_in)
        stiffness_Nm_rad = arm.gear_stiffness_Nm_rad[:, None]
        backlash_rad = at.backlash_rad * np.exp(x[BACKLASHES])[:, None] - at.friction_Nm / stiffness_Nm_rad
        gravity_D = X_RD.R.T @ at.gravity_R_m_s2
        rest = settle(arm, at.motor_rad, backlash_rad, gravity_D)
        X_RT = add_batch_axis(X_RD) @ (rest.frames.X_RF[5] @ add_batch_axis(X_FT))
        parts.append(TurretPoses(where, at, stand_in, arm, gravity_D, rest, X_FT, X_RT))
    return parts


def joint_jacobian(parts: Sequence[TurretPoses]) -> Array:
    """Compute the screws of the turret frame in its own axes per radian of each output, (6, n, 5)."""
    jacobian = np.empty((6, _pose_count(parts), JOINT_COUNT))
    for part in parts:
        unit_rotations = np.zeros((SCREW, part.where.size, JOINT_COUNT))
        unit_rotations[range(JOINT_COUNT), :, range(JOINT_COUNT)] = 1.0
        no_screws = np.zeros((6 * len(Frame), JOINT_COUNT))
        jacobian[:, part.where] = screw_derivatives(
            part.differentiate(), np.zeros_like(unit_rotations), unit_rotations, no_screws
        )
    return jacobian


def _parameter_jacobian(parts: Sequence[TurretPoses], x: Array) -> tuple[Pose, Array]:
    """Compute X_RT, batch (n,), and its screws in its own axes per unit of each parameter, (6, n, p)."""
    n = _pose_count(parts)
    jacobian = np.empty((6, n, PARAMETER_COUNT))
    screws = np.zeros((6 * len(Frame), PARAMETER_COUNT))
    for frame in Frame:
        rows = slice(6 * frame, 6 * frame + 6)
        screws[rows, FRAME_SCREWS][:, rows] = _right_jacobian(_screw(x, frame))
    for part in parts:
        deflection = part.differentiate()
        dQ = _load_derivatives(deflection, x, part.stand_in)
        jacobian[:, part.where] = screw_derivatives(
            deflection, dQ, _direct_derivatives(deflection, x, part.at), screws
        )
    return reorder_poses(((part.where, part.X_RT) for part in parts), n), jacobian


def _pose_count(parts: Sequence[TurretPoses]) -> int:
    return sum(part.where.size for part in parts)


def _load_derivatives(deflection: DeflectionDerivatives, x: Array, stand_in: bool) -> Array:
    """Compute the derivatives of loads by masses and centres of mass, shape (SCREW, n, p)."""
    n = deflection.rest.output_rad.shape[1]
    dQ = np.zeros((SCREW, n, PARAMETER_COUNT))
    for k, frame in enumerate(MASS_FRAMES):
        sides = slice(0, 1 if frame is Frame.ARM6 and stand_in else 2)  # the mass of a stand-in was weighed
        dQ[:, :, MASS_FACTORS.start + k] = deflection.lump_Q[:, sides, frame].sum(axis=1)
        near, far = np.moveaxis(deflection.lump_dQ[:, :, frame], 1, 0)
        if frame is Frame.ARM6:  # the turret's own mass rotates with the frame error
            far = np.einsum("cin,ij->cjn", far, turret_displacement(deflection.arm, x).R)
        start = MASS_CENTRES.start + 3 * k
        dQ[:, :, start : start + 3] = np.moveaxis(near + far, 1, 2)
    return dQ


def _direct_derivatives(deflection: DeflectionDerivatives, x: Array, at: BelievedPoses) -> Array:
    """Compute the derivatives of strains and joint angles by stiffnesses and backlashes, (SCREW, n, p)."""
    rest, n = deflection.rest, deflection.rest.output_rad.shape[1]
    direct = np.zeros((SCREW, n, PARAMETER_COUNT))
    carried_Nm = rest.torque_Nm - at.friction_Nm
    for joint in Joint:
        stiffness = deflection.arm.gear_stiffness_Nm_rad[joint]
        direct[joint, :, GEAR_STIFFNESSES.start + joint] = -carried_Nm[joint] / stiffness
        direct[joint, :, BACKLASHES.start + joint] = at.backlash_rad[joint] * np.exp(
            x[BACKLASHES.start + joint]
        )
    for k, frame in enumerate(SPRING_FRAMES):
        start = STRAIN + 6 * frame
        direct[start : start + 6, :, LINK_STIFFNESSES.start + k] = -rest.strain[:, frame]
    return direct


def _right_jacobian(screw: Array) -> Array:
    """Compute the right Jacobian J, (6, 6), of the exponential: exp(x + d) = exp(x) exp(J d).

    The series ends after the third power of x.
    """
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = skew(screw[:3])
    ad[3:, :3] = skew(screw[3:])
    return np.eye(6) - ad / 2 + ad @ ad / 6 - ad @ ad @ ad / 24

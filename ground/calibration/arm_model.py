"""The residuals of our arm's poses and their derivatives: the hanging arm against the tracker."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import Params
from fsw.kinematics.arm import Arm, build_arm
from fsw.kinematics.statics import Equilibrium, settle
from fsw.kinematics.transforms import Array, Flags, Integers, Pose, screw_exp, skew
from ground.calibration.arm_parameters import (
    BACKLASHES,
    FRAME_SCREWS,
    GEAR_STIFFNESSES,
    LINK_STIFFNESSES,
    MASS_CENTRES,
    MASS_FACTORS,
    MASS_FRAMES,
    arm_parameters,
    arm_with_values,
    turret_displacement,
)
from ground.calibration.backlash_side import confirm_sides, pose_whitener
from ground.calibration.campaign_data import BelievedPoses, Campaign
from ground.calibration.deflection_jacobian import (
    JOINT_COUNT,
    SCREW,
    STRAIN,
    DeflectionDerivatives,
    add_batch_axis,
    differentiate_deflection,
    screw_derivatives,
)
from ground.calibration.fit import Fit, Linearisation
from ground.calibration.screws import MeasuredPoses, error_screw, linearise
from sim.arms import SPRING_FRAMES
from sim.effects.structure import params_with_stand_in

PARAMETER_COUNT: Final = len(arm_parameters())


@dataclass(frozen=True, slots=True, eq=False)
class ArmModel:
    """Residuals of a campaign's poses as a function of the arm's numbers."""

    nominal: Params
    """What the numbers are differences from."""
    believed: BelievedPoses
    measured: MeasuredPoses
    whitener: Array
    """(n, 6, 6)."""
    unknown: Flags
    """Outputs whose place in their gap nobody knows, (5, n)."""

    def __call__(self, x: Array) -> Linearisation:
        """Whitened error screws (n, 6) and their derivatives."""
        X, moved = _parameter_jacobian(settle_poses(self.nominal, x, self.believed), x)
        return linearise(X, moved, self.measured, self.whitener)

    def errors(self, x: Array) -> Array:
        """Error screws (6, n) from the modelled poses to the measured ones."""
        return error_screw(predict_poses(self.nominal, x, self.believed), self.measured)


def arm_model(
    nominal: Params,
    campaign: Campaign,
    near: Fit | None = None,
    with_backlash: bool = True,
    blind: Flags | None = None,
) -> ArmModel:
    """The model of a campaign; given a fit near the right one, with what it tells about unsure gaps.

    Of `blind` poses (n,) no unsure gap is looked at: they are to judge. Without backlash state every output
    is taken to lie always on the side on which it mostly lies, surely.
    """
    believed, unknown = campaign.believed, campaign.believed.side == 0
    if not with_backlash:
        believed, unknown = _fix_sides(believed), np.zeros_like(unknown)
    x = np.zeros(PARAMETER_COUNT) if near is None else near.values
    parts = settle_poses(nominal, x, believed)
    by_joints = joint_jacobian(parts)
    if near is not None:
        X, moved = _parameter_jacobian(parts, x)
        error = error_screw(X, campaign.measured)
        asked = unknown if blind is None else unknown & ~blind
        agree = confirm_sides(
            campaign.measured, by_joints, error, moved, near.covariance, asked, believed.backlash_rad
        )
        unknown = unknown & ~agree
    return ArmModel(
        nominal, believed, campaign.measured, pose_whitener(campaign.measured, by_joints, unknown), unknown
    )


def _fix_sides(believed: BelievedPoses) -> BelievedPoses:
    """Every output in one place of its gap: which one makes no difference to a fit, zeros take it up."""
    half = np.abs(believed.backlash_rad).max(axis=1, keepdims=True)
    side = np.where(believed.backlash_rad.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return replace(believed, backlash_rad=np.broadcast_to(side * half, believed.backlash_rad.shape))


def group_by_turret(believed: BelievedPoses) -> list[tuple[float | None, Integers]]:
    """The turrets in use, None for the arm's own, each with its poses."""
    kinds = np.unique(believed.turret_kg)
    own = np.isnan(believed.turret_kg)
    found: list[tuple[float | None, Integers]] = [
        (float(kg), np.flatnonzero(believed.turret_kg == kg)) for kg in kinds if np.isfinite(kg)
    ]
    return [*found, *([(None, np.flatnonzero(own))] if own.any() else [])]


def predict_poses(nominal: Params, x: Array, believed: BelievedPoses) -> Pose:
    """Where the turret frame is modelled to be, X_RT, batch (n,)."""
    parts = (
        (where, _settle_arm(nominal, x, turret_kg, believed.at(where)).X_RT)
        for turret_kg, where in group_by_turret(believed)
    )
    return reorder_poses(parts, believed.motor_rad.shape[1])


def reorder_poses(parts: Iterable[tuple[Integers, Pose]], n: int) -> Pose:
    """One batch (n,) of poses that come in parts, each with the numbers of its own."""
    X = Pose(np.empty((3, 3, n)), np.empty((3, n)))
    for where, part in parts:
        X.R[:, :, where], X.p[:, where] = part.R, part.p
    return X


@dataclass(frozen=True, slots=True, eq=False)
class RestingArm:
    """The arm with some numbers at rest, in the frame D in which it is mounted: the rover turned by Arm1."""

    arm: Arm
    X_RD: Pose
    X_FT: Pose
    gravity_D_m_s2: Array
    rest: Equilibrium

    @property
    def X_RT(self) -> Pose:
        """The turret frame, batch (n,)."""
        X_DT = self.rest.frames.X_RF[5] @ add_batch_axis(self.X_FT)
        return add_batch_axis(self.X_RD) @ X_DT


def _settle_arm(nominal: Params, x: Array, turret_kg: float | None, at: BelievedPoses) -> RestingArm:
    arm, X_RD = arm_with_values(build_arm(params_with_stand_in(nominal, turret_kg)), x, turret_kg is not None)
    gap = (
        at.backlash_rad * np.exp(x[BACKLASHES])[:, None] - at.friction_Nm / arm.gear_stiffness_Nm_rad[:, None]
    )
    gravity_D = X_RD.R.T @ at.gravity_R_m_s2
    rest = settle(arm, at.motor_rad, gap, gravity_D)
    return RestingArm(arm, X_RD, screw_exp(_screw(x, Frame.TOOL)), gravity_D, rest)


def _screw(x: Array, frame: Frame) -> Array:
    return x[6 * frame : 6 * frame + 6]


@dataclass(frozen=True, slots=True, eq=False)
class TurretPoses:
    """The poses with one turret, at rest, and what moves them."""

    where: Integers
    """Which of all they are."""
    at: BelievedPoses
    stand_in: bool
    X_RT: Pose
    derivatives: DeflectionDerivatives


def settle_poses(nominal: Params, x: Array, believed: BelievedPoses) -> list[TurretPoses]:
    """All poses, turret by turret."""
    parts = []
    for turret_kg, where in group_by_turret(believed):
        at = believed.at(where)
        held = _settle_arm(nominal, x, turret_kg, at)
        hang = differentiate_deflection(held.arm, held.rest, held.gravity_D_m_s2, held.X_FT)
        parts.append(TurretPoses(where, at, turret_kg is not None, held.X_RT, hang))
    return parts


def joint_jacobian(parts: Sequence[TurretPoses]) -> Array:
    """The screw by which the turret frame moves, in its own axes, per turn of each output, (6, n, joints)."""
    moved = np.empty((6, _pose_count(parts), JOINT_COUNT))
    for part in parts:
        turns = np.zeros((SCREW, part.where.size, JOINT_COUNT))
        turns[range(JOINT_COUNT), :, range(JOINT_COUNT)] = 1.0
        still = np.zeros((6 * len(Frame), JOINT_COUNT))
        moved[:, part.where] = screw_derivatives(part.derivatives, np.zeros_like(turns), turns, still)
    return moved


def _parameter_jacobian(parts: Sequence[TurretPoses], x: Array) -> tuple[Pose, Array]:
    """The turret frame's poses, and the screws by which they move per unit of each number, (6, n, COUNT)."""
    n = _pose_count(parts)
    moved = np.empty((6, n, PARAMETER_COUNT))
    screws = np.zeros((6 * len(Frame), PARAMETER_COUNT))
    for frame in Frame:
        rows = slice(6 * frame, 6 * frame + 6)
        screws[rows, FRAME_SCREWS][:, rows] = _right_jacobian(_screw(x, frame))
    for part in parts:
        dQ = _load_derivatives(part.derivatives, x, part.stand_in)
        moved[:, part.where] = screw_derivatives(
            part.derivatives, dQ, _direct_derivatives(part.derivatives, x, part.at), screws
        )
    return reorder_poses(((part.where, part.X_RT) for part in parts), n), moved


def _pose_count(parts: Sequence[TurretPoses]) -> int:
    return sum(part.where.size for part in parts)


def _load_derivatives(hang: DeflectionDerivatives, x: Array, stand_in: bool) -> Array:
    """What masses and centres do to the loads, (SCREW, n, COUNT)."""
    n = hang.rest.output_rad.shape[1]
    dQ = np.zeros((SCREW, n, PARAMETER_COUNT))
    for k, frame in enumerate(MASS_FRAMES):
        sides = slice(0, 1 if frame is Frame.ARM6 and stand_in else 2)  # a stand-in is weighed
        dQ[:, :, MASS_FACTORS.start + k] = hang.lump_Q[:, sides, frame].sum(axis=1)
        near, far = np.moveaxis(hang.lump_dQ[:, :, frame], 1, 0)
        if frame is Frame.ARM6:  # the turret's own mass turns with the frame
            far = np.einsum("cin,ij->cjn", far, turret_displacement(hang.arm, x).R)
        start = MASS_CENTRES.start + 3 * k
        dQ[:, :, start : start + 3] = np.moveaxis(near + far, 1, 2)
    return dQ


def _direct_derivatives(hang: DeflectionDerivatives, x: Array, at: BelievedPoses) -> Array:
    """What stiffnesses and backlash widths do to strains and joint angles themselves, (SCREW, n, COUNT)."""
    rest, n = hang.rest, hang.rest.output_rad.shape[1]
    direct = np.zeros((SCREW, n, PARAMETER_COUNT))
    carried_Nm = rest.torque_Nm - at.friction_Nm
    for joint in Joint:
        stiffness = hang.arm.gear_stiffness_Nm_rad[joint]
        direct[joint, :, GEAR_STIFFNESSES.start + joint] = -carried_Nm[joint] / stiffness
        direct[joint, :, BACKLASHES.start + joint] = at.backlash_rad[joint] * np.exp(
            x[BACKLASHES.start + joint]
        )
    for k, frame in enumerate(SPRING_FRAMES):
        start = STRAIN + 6 * frame
        direct[start : start + 6, :, LINK_STIFFNESSES.start + k] = -rest.strain[:, frame]
    return direct


def _right_jacobian(screw: Array) -> Array:
    """Of the exponential, (6, 6): exp(x + d) = exp(x) exp(this d), to the third power of x."""
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = skew(screw[:3])
    ad[3:, :3] = skew(screw[3:])
    return np.eye(6) - ad / 2 + ad @ ad / 6 - ad @ ad @ ad / 24

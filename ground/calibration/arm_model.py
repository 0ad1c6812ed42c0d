"""The residuals of our arm's poses and their derivatives: the hanging arm against the tracker."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.dictionary.joints import Frame, Joint
from fsw.dictionary.params import Params
from fsw.kinematics.arm import Arm, arm_from
from fsw.kinematics.statics import Equilibrium, settle
from fsw.kinematics.transforms import Array, Flags, Numbers, Pose, rotation_z, screw_exp, skew
from ground.calibration.arm_numbers import (
    CENTRES,
    FRAMES,
    GAPS,
    GEARS,
    LINKS,
    MASS_OF,
    MASSES,
    arm_parameters,
    arm_with,
)
from ground.calibration.data import Believed, Campaign
from ground.calibration.fit import Fit
from ground.calibration.gaps import agreeing
from ground.calibration.hanging import JOINTS, SCREW, STRAIN, Hanging, hanging, motion
from ground.calibration.noise import whitener_of
from ground.calibration.problem import Linearised
from ground.calibration.screws import Measured, error_screw, linearised
from sim.effects.built import SPRINGS
from sim.effects.turret import TurretMass

COUNT: Final = len(arm_parameters())


@dataclass(frozen=True, slots=True, eq=False)
class ArmModel:
    """Residuals of a campaign's poses as a function of the arm's numbers."""

    nominal: Params
    """What the numbers are differences from."""
    believed: Believed
    measured: Measured
    whitener: Array
    """(n, 6, 6)."""
    unknown: Flags
    """Outputs whose place in their gap nobody knows, (5, n)."""

    def __call__(self, x: Array) -> Linearised:
        """Whitened error screws (n, 6) and their derivatives.

        Exact, but for a share of 1e-4 in turns of Arm1: its spring's axes turn with it, in what order they
        yield is neglected.
        """
        X, moved = _moved(self.nominal, x, self.believed)
        return linearised(X, moved, self.measured, self.whitener)

    def errors(self, x: Array) -> Array:
        """Error screws (6, n) from the modelled poses to the measured ones."""
        return error_screw(modelled(self.nominal, x, self.believed), self.measured)


def arm_model(
    nominal: Params, campaign: Campaign, near: Fit | None = None, with_backlash: bool = True
) -> ArmModel:
    """The model of a campaign; given a fit near the right one, with what it tells about unsure gaps.

    Without backlash state every output is taken to lie always on the side on which it mostly lies, surely.
    """
    believed, unknown = campaign.believed, campaign.believed.side == 0
    if not with_backlash:
        believed, unknown = _on_one_side(believed), np.zeros_like(unknown)
    x = np.zeros(COUNT) if near is None else near.values
    by_joints = moved_by_joints(nominal, x, believed)
    if near is not None:
        error = error_screw(modelled(nominal, x, believed), campaign.measured)
        width = near.sigma[GAPS, None] * np.abs(believed.gap_rad)
        unknown = unknown & ~agreeing(campaign.measured, by_joints, error, unknown, width)
    return ArmModel(
        nominal, believed, campaign.measured, whitener_of(campaign.measured, by_joints, unknown), unknown
    )


def _on_one_side(believed: Believed) -> Believed:
    """Every output in one place of its gap: which one makes no difference to a fit, zeros take it up."""
    half = np.abs(believed.gap_rad).max(axis=1, keepdims=True)
    side = np.where(believed.gap_rad.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return replace(believed, gap_rad=np.broadcast_to(side * half, believed.gap_rad.shape))


def turrets(believed: Believed) -> list[tuple[float | None, Numbers]]:
    """The turrets in use, None for the arm's own, each with its poses."""
    kinds = np.unique(believed.turret_kg)
    own = np.isnan(believed.turret_kg)
    found: list[tuple[float | None, Numbers]] = [
        (float(kg), np.flatnonzero(believed.turret_kg == kg)) for kg in kinds if np.isfinite(kg)
    ]
    return [*found, *([(None, np.flatnonzero(own))] if own.any() else [])]


def modelled(nominal: Params, x: Array, believed: Believed) -> Pose:
    """Where the turret frame is modelled to be, X_RT, batch (n,)."""
    n = believed.motor_rad.shape[1]
    X = Pose(np.empty((3, 3, n)), np.empty((3, n)))
    for turret_kg, where in turrets(believed):
        _, rest = _at_rest(nominal, x, turret_kg, believed.at(where))
        X_RT = _last(rest, x)
        X.R[:, :, where], X.p[:, where] = X_RT.R, X_RT.p
    return X


def arm_of(nominal: Params, x: Array, turret_kg: float | None) -> Arm:
    """The arm with these numbers and this turret."""
    params = arm_with(nominal, x)
    return arm_from(params if turret_kg is None else TurretMass(turret_kg).on_params(params))


def _at_rest(nominal: Params, x: Array, turret_kg: float | None, at: Believed) -> tuple[Arm, Equilibrium]:
    arm = arm_of(nominal, x, turret_kg)
    gap = at.gap_rad * np.exp(x[GAPS])[:, None] - at.held_Nm / arm.gear_stiffness_Nm_rad[:, None]
    return arm, settle(arm, at.motor_rad, gap, at.gravity_R_m_s2)


def _last(rest: Equilibrium, x: Array) -> Pose:
    X_RF, X_FT = rest.frames.X_RF, screw_exp(_screw(x, Frame.TOOL))
    return Pose(X_RF.R[:, :, 5], X_RF.p[:, 5]) @ Pose(X_FT.R[:, :, None], X_FT.p[:, None])


def _screw(x: Array, frame: Frame) -> Array:
    return x[6 * frame : 6 * frame + 6]


def moved_by_joints(nominal: Params, x: Array, believed: Believed) -> Array:
    """The screw by which the turret frame moves, in its own axes, per turn of each output, (6, n, joints)."""
    moved = np.empty((6, believed.motor_rad.shape[1], JOINTS))
    for turret_kg, where in turrets(believed):
        hang = _hanging(nominal, x, turret_kg, believed.at(where))
        turns = np.zeros((SCREW, where.size, JOINTS))
        turns[range(JOINTS), :, range(JOINTS)] = 1.0
        moved[:, where] = motion(hang, np.zeros_like(turns), turns, np.zeros((6 * len(Frame), JOINTS)))
    return moved


def _moved(nominal: Params, x: Array, believed: Believed) -> tuple[Pose, Array]:
    """The turret frame's poses, and the screws by which they move per unit of each number, (6, n, COUNT)."""
    n = believed.motor_rad.shape[1]
    X, moved = Pose(np.empty((3, 3, n)), np.empty((3, n))), np.empty((6, n, COUNT))
    drawn = arm_from(nominal)
    screws = np.zeros((6 * len(Frame), COUNT))
    for frame in Frame:
        rows = slice(6 * frame, 6 * frame + 6)
        screws[rows, FRAMES][:, rows] = _right_jacobian(_screw(x, frame))
    for turret_kg, where in turrets(believed):
        at = believed.at(where)
        hang = _hanging(nominal, x, turret_kg, at)
        moved[:, where] = motion(hang, _by_loads(drawn, hang, turret_kg), _by_springs(hang, x, at), screws)
        X.R[:, :, where], X.p[:, where] = hang.X_RT.R, hang.X_RT.p
    return X, moved


def _hanging(nominal: Params, x: Array, turret_kg: float | None, at: Believed) -> Hanging:
    arm, rest = _at_rest(nominal, x, turret_kg, at)
    return hanging(arm, rest, at.gravity_R_m_s2, screw_exp(_screw(x, Frame.TOOL)))


def _by_loads(drawn: Arm, hang: Hanging, turret_kg: float | None) -> Array:
    """What masses and centres do to the loads, (SCREW, n, COUNT)."""
    n = hang.rest.output_rad.shape[1]
    dQ = np.zeros((SCREW, n, COUNT))
    for k, frame in enumerate(MASSES):
        sides = slice(0, 1 if frame is Frame.ARM6 and turret_kg is not None else 2)  # a stand-in is weighed
        dQ[:, :, MASS_OF.start + k] = hang.lump_Q[:, sides, frame].sum(axis=1)
        of_centre = np.einsum("csin,sij->cjn", hang.lump_dQ[:, :, frame], _turns(drawn, hang.arm, frame))
        start = CENTRES.start + 3 * k
        dQ[:, :, start : start + 3] = np.moveaxis(of_centre, 1, 2)
    return dQ


def _turns(drawn: Arm, arm: Arm, frame: Frame) -> Array:
    """How the axes in which a link's centres are shifted lie in its own axes, (2, 3, 3): near lump, far lump.

    A screw of the frame turns the link's axes about z; the turret's own mass it takes along.
    """
    turned = drawn.theta_rad[frame] - arm.theta_rad[frame]
    near = rotation_z(np.array(turned))
    if frame is not Frame.ARM6:
        return np.stack([near, near])
    to, back = rotation_z(np.array(drawn.theta_rad[frame])), drawn.X_CF.R[:, :, frame]
    return np.stack([near, to @ arm.X_CF.R[:, :, frame] @ back.T @ to.T])


def _by_springs(hang: Hanging, x: Array, at: Believed) -> Array:
    """What stiffnesses and backlash widths do to strains and joint angles themselves, (SCREW, n, COUNT)."""
    rest, n = hang.rest, hang.rest.output_rad.shape[1]
    direct = np.zeros((SCREW, n, COUNT))
    carried_Nm = rest.torque_Nm - at.held_Nm
    for joint in Joint:
        stiffness = hang.arm.gear_stiffness_Nm_rad[joint]
        direct[joint, :, GEARS.start + joint] = -carried_Nm[joint] / stiffness
        direct[joint, :, GAPS.start + joint] = at.gap_rad[joint] * np.exp(x[GAPS.start + joint])
    for k, frame in enumerate(SPRINGS):
        start = STRAIN + 6 * frame
        direct[start : start + 6, :, LINKS.start + k] = -rest.strain[:, frame]
    return direct


def _right_jacobian(screw: Array) -> Array:
    """Of the exponential, (6, 6): exp(x + d) = exp(x) exp(this d), to the third power of x."""
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = skew(screw[:3])
    ad[3:, :3] = skew(screw[3:])
    return np.eye(6) - ad / 2 + ad @ ad / 6 - ad @ ad @ ad / 24

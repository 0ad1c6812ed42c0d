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
from ground.calibration.arm_numbers import (
    CENTRES,
    FRAMES,
    GAPS,
    GEARS,
    LINKS,
    MASS_OF,
    MASSES,
    arm_parameters,
    numbered_arm,
    turret_turn,
)
from ground.calibration.data import Believed, Campaign
from ground.calibration.fit import Fit
from ground.calibration.gaps import agreeing
from ground.calibration.hanging import JOINTS, SCREW, STRAIN, Hanging, hanging, motion, with_batch
from ground.calibration.noise import whitener_of
from ground.calibration.problem import Linearised
from ground.calibration.screws import Measured, error_screw, linearised
from sim.arms import SPRING_FRAMES
from sim.effects.structure import params_with_stand_in

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
        """Whitened error screws (n, 6) and their derivatives."""
        X, moved = _moved(hung(self.nominal, x, self.believed), x)
        return linearised(X, moved, self.measured, self.whitener)

    def errors(self, x: Array) -> Array:
        """Error screws (6, n) from the modelled poses to the measured ones."""
        return error_screw(modelled(self.nominal, x, self.believed), self.measured)


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
        believed, unknown = _on_one_side(believed), np.zeros_like(unknown)
    x = np.zeros(COUNT) if near is None else near.values
    parts = hung(nominal, x, believed)
    by_joints = moved_by_joints(parts)
    if near is not None:
        X, moved = _moved(parts, x)
        error = error_screw(X, campaign.measured)
        asked = unknown if blind is None else unknown & ~blind
        agree = agreeing(campaign.measured, by_joints, error, moved, near.covariance, asked, believed.gap_rad)
        unknown = unknown & ~agree
    return ArmModel(
        nominal, believed, campaign.measured, whitener_of(campaign.measured, by_joints, unknown), unknown
    )


def _on_one_side(believed: Believed) -> Believed:
    """Every output in one place of its gap: which one makes no difference to a fit, zeros take it up."""
    half = np.abs(believed.gap_rad).max(axis=1, keepdims=True)
    side = np.where(believed.gap_rad.sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return replace(believed, gap_rad=np.broadcast_to(side * half, believed.gap_rad.shape))


def turrets(believed: Believed) -> list[tuple[float | None, Integers]]:
    """The turrets in use, None for the arm's own, each with its poses."""
    kinds = np.unique(believed.turret_kg)
    own = np.isnan(believed.turret_kg)
    found: list[tuple[float | None, Integers]] = [
        (float(kg), np.flatnonzero(believed.turret_kg == kg)) for kg in kinds if np.isfinite(kg)
    ]
    return [*found, *([(None, np.flatnonzero(own))] if own.any() else [])]


def modelled(nominal: Params, x: Array, believed: Believed) -> Pose:
    """Where the turret frame is modelled to be, X_RT, batch (n,)."""
    parts = (
        (where, _held(nominal, x, turret_kg, believed.at(where)).X_RT)
        for turret_kg, where in turrets(believed)
    )
    return in_order(parts, believed.motor_rad.shape[1])


def in_order(parts: Iterable[tuple[Integers, Pose]], n: int) -> Pose:
    """One batch (n,) of poses that come in parts, each with the numbers of its own."""
    X = Pose(np.empty((3, 3, n)), np.empty((3, n)))
    for where, part in parts:
        X.R[:, :, where], X.p[:, where] = part.R, part.p
    return X


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """The arm with some numbers at rest, in the frame D in which it is mounted: the rover turned by Arm1."""

    arm: Arm
    X_RD: Pose
    X_FT: Pose
    gravity_D_m_s2: Array
    rest: Equilibrium

    @property
    def X_RT(self) -> Pose:
        """The turret frame, batch (n,)."""
        X_DT = self.rest.frames.X_RF[5] @ with_batch(self.X_FT)
        return with_batch(self.X_RD) @ X_DT


def _held(nominal: Params, x: Array, turret_kg: float | None, at: Believed) -> Held:
    arm, X_RD = numbered_arm(build_arm(params_with_stand_in(nominal, turret_kg)), x, turret_kg is not None)
    gap = at.gap_rad * np.exp(x[GAPS])[:, None] - at.held_Nm / arm.gear_stiffness_Nm_rad[:, None]
    gravity_D = X_RD.R.T @ at.gravity_R_m_s2
    rest = settle(arm, at.motor_rad, gap, gravity_D)
    return Held(arm, X_RD, screw_exp(_screw(x, Frame.TOOL)), gravity_D, rest)


def _screw(x: Array, frame: Frame) -> Array:
    return x[6 * frame : 6 * frame + 6]


@dataclass(frozen=True, slots=True, eq=False)
class Hung:
    """The poses with one turret, at rest, and what moves them."""

    where: Integers
    """Which of all they are."""
    at: Believed
    stand_in: bool
    X_RT: Pose
    hang: Hanging


def hung(nominal: Params, x: Array, believed: Believed) -> list[Hung]:
    """All poses, turret by turret."""
    parts = []
    for turret_kg, where in turrets(believed):
        at = believed.at(where)
        held = _held(nominal, x, turret_kg, at)
        hang = hanging(held.arm, held.rest, held.gravity_D_m_s2, held.X_FT)
        parts.append(Hung(where, at, turret_kg is not None, held.X_RT, hang))
    return parts


def moved_by_joints(parts: Sequence[Hung]) -> Array:
    """The screw by which the turret frame moves, in its own axes, per turn of each output, (6, n, joints)."""
    moved = np.empty((6, _count(parts), JOINTS))
    for part in parts:
        turns = np.zeros((SCREW, part.where.size, JOINTS))
        turns[range(JOINTS), :, range(JOINTS)] = 1.0
        still = np.zeros((6 * len(Frame), JOINTS))
        moved[:, part.where] = motion(part.hang, np.zeros_like(turns), turns, still)
    return moved


def _moved(parts: Sequence[Hung], x: Array) -> tuple[Pose, Array]:
    """The turret frame's poses, and the screws by which they move per unit of each number, (6, n, COUNT)."""
    n = _count(parts)
    moved = np.empty((6, n, COUNT))
    screws = np.zeros((6 * len(Frame), COUNT))
    for frame in Frame:
        rows = slice(6 * frame, 6 * frame + 6)
        screws[rows, FRAMES][:, rows] = _right_jacobian(_screw(x, frame))
    for part in parts:
        dQ = _by_loads(part.hang, x, part.stand_in)
        moved[:, part.where] = motion(part.hang, dQ, _by_springs(part.hang, x, part.at), screws)
    return in_order(((part.where, part.X_RT) for part in parts), n), moved


def _count(parts: Sequence[Hung]) -> int:
    return sum(part.where.size for part in parts)


def _by_loads(hang: Hanging, x: Array, stand_in: bool) -> Array:
    """What masses and centres do to the loads, (SCREW, n, COUNT)."""
    n = hang.rest.output_rad.shape[1]
    dQ = np.zeros((SCREW, n, COUNT))
    for k, frame in enumerate(MASSES):
        sides = slice(0, 1 if frame is Frame.ARM6 and stand_in else 2)  # a stand-in is weighed
        dQ[:, :, MASS_OF.start + k] = hang.lump_Q[:, sides, frame].sum(axis=1)
        near, far = np.moveaxis(hang.lump_dQ[:, :, frame], 1, 0)
        if frame is Frame.ARM6:  # the turret's own mass turns with the frame
            far = np.einsum("cin,ij->cjn", far, turret_turn(hang.arm, x).R)
        start = CENTRES.start + 3 * k
        dQ[:, :, start : start + 3] = np.moveaxis(near + far, 1, 2)
    return dQ


def _by_springs(hang: Hanging, x: Array, at: Believed) -> Array:
    """What stiffnesses and backlash widths do to strains and joint angles themselves, (SCREW, n, COUNT)."""
    rest, n = hang.rest, hang.rest.output_rad.shape[1]
    direct = np.zeros((SCREW, n, COUNT))
    carried_Nm = rest.torque_Nm - at.held_Nm
    for joint in Joint:
        stiffness = hang.arm.gear_stiffness_Nm_rad[joint]
        direct[joint, :, GEARS.start + joint] = -carried_Nm[joint] / stiffness
        direct[joint, :, GAPS.start + joint] = at.gap_rad[joint] * np.exp(x[GAPS.start + joint])
    for k, frame in enumerate(SPRING_FRAMES):
        start = STRAIN + 6 * frame
        direct[start : start + 6, :, LINKS.start + k] = -rest.strain[:, frame]
    return direct


def _right_jacobian(screw: Array) -> Array:
    """Of the exponential, (6, 6): exp(x + d) = exp(x) exp(this d), to the third power of x."""
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = skew(screw[:3])
    ad[3:, :3] = skew(screw[3:])
    return np.eye(6) - ad / 2 + ad @ ad / 6 - ad @ ad @ ad / 24

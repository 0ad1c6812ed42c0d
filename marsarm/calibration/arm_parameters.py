"""Calibration parameters of the arm: names, expected sizes, and their effect on the arm model.

In all functions, `x` are values of the parameters, (p,), each in its unit.

The exact derivatives of the last frame of a deflected arm by the parameters have as coordinates joint angles,
strains of springs and small screws of frames. Coordinate c moves all bodies beyond it along a screw
S_c = (w, v) in rover axes. With the gravity potential V = -sum(m g.p),

    Q_a = -dV/da = sum(m g.(w_a x p + v_a)),    dQ_a/db = (g x w_a).(w_b x M_b + m_b v_b)   (a before b)

with the mass m_b and its first moment M_b beyond the outer coordinate. Strains and wind-up follow the load,
y = C Q(y, x) + ..., so the implicit function theorem gives their response to a parameter x:

    (1 - C dQ/dy) dy/dx = C dQ/dx + the direct derivative of y by x.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import LinkParams, Params
from fsw.dictionary.types import row6, vector3
from fsw.kinematics.arm import Arm, pose_to_transform6, transform6_to_pose
from fsw.kinematics.statics import Equilibrium
from fsw.kinematics.transforms import Array, Integers, Pose, adjoint, cross, inverse, rotation_z, screw_exp
from sim.arm_model.description import BuiltTolerances
from sim.arm_model.load import default_arm
from sim.effects.effect import rotate_matrix
from sim.effects.geometry import FrameError
from sim.effects.joints import BacklashWidth, GearStiffness
from sim.effects.structure import LinkMass, LinkStiffness
from sim.plant import SCREW_AXES
from sim.tolerances import SPRING_FRAMES
from simgap import FitParameter

MASS_FRAMES: Final = (Frame.ARM2, Frame.ARM3, Frame.ARM4, Frame.ARM5, Frame.ARM6)
FIXTURE_RAD, FIXTURE_M = 1e-4, 5e-5
"""Uncertainty of the measured frame relative to the turret interface, one sigma; assumed."""
ENCODER_ZEROS: Final = tuple(6 * frame + 2 for frame in Frame if frame < len(Joint))
"""Indices of the rotations of frames Arm1 to Arm5 about z.

This z axis is the axis of the next joint, so these rotations also hold the encoder zeros.
"""

FRAME_SCREWS: Final = slice(0, 42)
GEAR_STIFFNESSES: Final = slice(42, 47)
LINK_STIFFNESSES: Final = slice(47, 52)
BACKLASHES: Final = slice(52, 57)
MASS_FACTORS: Final = slice(57, 62)
MASS_CENTRES: Final = slice(62, 77)
PARAMETER_COUNT: Final = MASS_CENTRES.stop


def _scaled(name: str, unit: str, sigma: float) -> FitParameter:
    return FitParameter(name, unit, sigma, sigma)


def arm_parameters(built: BuiltTolerances | None = None) -> tuple[FitParameter, ...]:
    """List all parameters. Prior sigmas are the manufacturing tolerances. Factors are natural logarithms.

    Args:
        built: Tolerances of manufacture; None for those of the default arm.
    """
    built = built or default_arm().description.tolerances.built
    return (
        *_frame_screws(built),
        *(_scaled(f"gear.{j.name.lower()}", "ln", built.stiffness_share) for j in Joint),
        *(_scaled(f"spring.{f.name.lower()}", "ln", built.stiffness_share) for f in SPRING_FRAMES),
        *(_scaled(f"backlash.{j.name.lower()}", "ln", built.backlash_share) for j in Joint),
        *(_scaled(f"mass.{f.name.lower()}", "ln", built.mass_share) for f in MASS_FRAMES),
        *(
            _scaled(f"centre.{f.name.lower()}.{axis}", "m", built.com_m)
            for f in MASS_FRAMES
            for axis in "xyz"
        ),
    )


def _frame_screws(built: BuiltTolerances) -> Iterator[FitParameter]:
    for frame in Frame:
        for k, axis in enumerate(SCREW_AXES):
            scale = built.frame_rad if k < 3 else built.frame_m
            sigma = scale
            if frame is Frame.TOOL:
                sigma = FIXTURE_RAD if k < 3 else FIXTURE_M
            elif 6 * frame + k in ENCODER_ZEROS:
                sigma = float(np.hypot(built.frame_rad, built.hardstop_rad))
            yield FitParameter(f"{frame.name.lower()}.{axis}", "rad" if k < 3 else "m", scale, sigma)


def params_with_values(params: Params, x: Array) -> Params:
    """Apply values to the parameters of flight software.

    Factors of backlash change the backlash widths. The measured frame Tool is not part of the arm.
    """
    factor = np.exp(x)
    for joint in Joint:
        params = GearStiffness(joint, float(factor[GEAR_STIFFNESSES][joint])).on_params(params)
        params = BacklashWidth(joint, float(factor[BACKLASHES][joint])).on_params(params)
    for k, frame in enumerate(SPRING_FRAMES):
        params = LinkStiffness(frame, float(factor[LINK_STIFFNESSES][k])).on_params(params)
    for k, frame in enumerate(MASS_FRAMES):
        shift = vector3(x[MASS_CENTRES][3 * k : 3 * k + 3])
        params = LinkMass(frame, float(factor[MASS_FACTORS][k]), shift).on_params(params)
    for frame in Frame:  # last: the frame error of Arm6 also displaces the turret's mass
        if frame is not Frame.TOOL:
            params = FrameError(frame, row6(x[6 * frame : 6 * frame + 6])).on_params(params)
    return params


def arm_with_values(nominal: Arm, x: Array, stand_in: bool) -> tuple[Arm, Pose]:
    """Apply values to the arm as arrays.

    Link springs keep their axes, as in the plant; `params_with_values` turns them with the frame. The
    difference is less than a micrometre. The mass of a stand-in turret was weighed and is not changed.

    Returns:
        The arm, and X_RD, the frame in which it is mounted: the rover frame displaced by Arm1.
    """
    factor = np.exp(x)
    near_kg, far_kg = nominal.near_kg.copy(), nominal.far_kg.copy()
    near, far, compliance = nominal.near_p_L_m.copy(), nominal.far_p_C_m.copy(), nominal.compliance.copy()
    for k, frame in enumerate(MASS_FRAMES):
        near_kg[frame] *= factor[MASS_FACTORS][k]
        far_kg[frame] *= 1.0 if frame is Frame.ARM6 and stand_in else factor[MASS_FACTORS][k]
        near[:, frame] += x[MASS_CENTRES][3 * k : 3 * k + 3]
        far[:, frame] += x[MASS_CENTRES][3 * k : 3 * k + 3]
    for k, frame in enumerate(SPRING_FRAMES):
        compliance[:, :, frame] /= factor[LINK_STIFFNESSES][k]
    turn = turret_displacement(nominal, x)
    far[:, Frame.ARM6] = turn.R @ far[:, Frame.ARM6] + turn.p
    RP_CF = nominal.RP_CF.copy()
    for frame in tuple(Frame)[1:6]:
        X_CF = nominal.X_CF[frame] @ screw_exp(x[6 * frame : 6 * frame + 6])
        RP_CF[:, :3, frame], RP_CF[:, 3, frame] = X_CF.R, X_CF.p
    X_RF = (
        Pose(rotation_z(nominal.theta_rad[0]), np.zeros(3))
        @ Pose(np.eye(3), nominal.p_LC_m[:, 0])
        @ nominal.X_CF[0]
    )
    arm = replace(
        nominal,
        RP_CF=RP_CF,
        compliance=compliance,
        near_kg=near_kg,
        far_kg=far_kg,
        carried_kg=np.cumsum((near_kg + far_kg)[::-1])[::-1],
        near_p_L_m=near,
        far_p_C_m=far,
        gear_stiffness_Nm_rad=nominal.gear_stiffness_Nm_rad * factor[GEAR_STIFFNESSES],
    )
    return arm, X_RF @ screw_exp(x[:6]) @ inverse(X_RF)


def turret_displacement(nominal: Arm, x: Array) -> Pose:
    """Compute how the frame error of Arm6 displaces the turret's own mass, in axes of the last link."""
    R_CF = Pose(nominal.X_CF.R[:, :, 5], nominal.X_CF.p[:, 5])
    return R_CF @ screw_exp(x[6 * Frame.ARM6 : 6 * Frame.ARM6 + 6]) @ inverse(R_CF)


def move_zeros_to_hardstops(params: Params, x: Array) -> tuple[Array, Params]:
    """Move encoder zeros from the frames into the hardstop angles: zeros (5,) [rad], and changed parameters.

    A rotation of a frame about z equals an offset of the next joint, and so of its hardstop angle. The new
    angles are valid after each hardstop has been found again.
    """
    zero = x[list(ENCODER_ZEROS)].copy()
    arm = params_with_values(params, x)
    for joint in Joint:
        link, name = f"arm{joint + 1}", joint.name.lower()
        turned_back = _turn_end(getattr(arm.links, link), -float(zero[joint]))
        of_joint = getattr(arm.joints, name)
        moved = replace(of_joint, hardstop_rad=float(of_joint.hardstop_rad + zero[joint]))
        arm = replace(
            arm, links=replace(arm.links, **{link: turned_back}), joints=replace(arm.joints, **{name: moved})
        )
    return zero, arm


def _turn_end(link: LinkParams, angle_rad: float) -> LinkParams:
    """Rotate the end frame of a link about z; keep its spring and masses in place."""
    end = transform6_to_pose(link.transform) @ Pose(rotation_z(np.array(angle_rad)), np.zeros(3))
    transform = pose_to_transform6(end)
    back = rotation_z(np.array(link.transform.theta_rad - transform.theta_rad))
    return replace(
        link,
        transform=transform,
        elastic_centre_m=vector3(back @ np.array(link.elastic_centre_m)),
        compliance=rotate_matrix(link.compliance, back),
        near=replace(link.near, com_m=vector3(back @ np.array(link.near.com_m))),
        far=replace(link.far, com_m=vector3(back @ np.array(link.far.com_m))),
    )


LINK_COUNT, JOINT_COUNT = 6, 5
TURN, STRAIN, SCREW = 0, JOINT_COUNT, JOINT_COUNT + 6 * LINK_COUNT
"""First index of each kind of coordinate: joint angles, strains of springs, screws of frames."""
COORDINATE_COUNT = SCREW + 6 * (LINK_COUNT + 1)
COMPLIANT = slice(0, SCREW)
"""Coordinates that follow the load."""
LINK, NEAR, SPRING, ON_FAR, FAR, END = 100, 10, 20, 29, 30, 40
"""Positions along a link, used to order coordinates and masses.

The joint is at 0, followed by near lump, six spring coordinates, far lump and next frame.
"""


@dataclass(frozen=True, slots=True, eq=False)
class DeflectionDerivatives:
    """Static equilibria of the arm with derivatives by its coordinates; the batch axis is last."""

    arm: Arm
    rest: Equilibrium
    S: Array
    """Screws of all coordinates in rover axes, shape (COORDINATE_COUNT, 6, n)."""
    C: Array
    """Compliance matrix of the compliant coordinates, shape (SCREW, SCREW)."""
    dQ: Array
    """Derivatives of loads by coordinates, shape (n, COORDINATE_COUNT, COORDINATE_COUNT)."""
    lump_Q: Array
    """Loads of near and far lumps on the compliant coordinates, shape (SCREW, 2, LINK_COUNT, n)."""
    lump_dQ: Array
    """Derivatives of these loads by the centres of mass in link axes, shape (SCREW, 2, LINK_COUNT, 3, n)."""
    X_RT: Pose
    """Frame T, whose motion is wanted, in the rover frame."""


def differentiate_deflection(
    arm: Arm, rest: Equilibrium, gravity_R_m_s2: Array, X_FT: Pose
) -> DeflectionDerivatives:
    """Compute the derivatives of static equilibria by all coordinates.

    Args:
        X_FT: Frame T in the last frame of the arm.
    """
    S, position = _screws(arm, rest, X_FT)
    near, far = _lumps(arm, rest)
    kg = np.stack([arm.near_kg, arm.far_kg])
    lumps = np.stack([near, far])  # axes: side, xyz, link, n
    # a coordinate carries the lumps that come after it along the arm
    lump_place = LINK * np.arange(LINK_COUNT) + np.array([[NEAR], [FAR]])
    carried = (position[:, None, None] < lump_place) * kg
    m = carried.sum(axis=(1, 2))
    M = np.einsum("csl,sxln->cxn", carried, lumps)
    a = cross(gravity_R_m_s2[:, None], S[:, :3].swapaxes(0, 1))
    b = cross(S[:, :3].swapaxes(0, 1), M.swapaxes(0, 1)) + m[:, None] * S[:, 3:].swapaxes(0, 1)
    h = np.moveaxis(a, -1, 0).swapaxes(1, 2) @ np.moveaxis(b, -1, 0)
    is_inner = position[:, None] <= position
    y = S[COMPLIANT]
    along = np.einsum("csl,xn,cxsln->csln", carried[COMPLIANT], gravity_R_m_s2, _velocity(y, lumps))
    return DeflectionDerivatives(
        arm=arm,
        rest=rest,
        S=S,
        C=_compliance(arm),
        dQ=np.where(is_inner, h, h.swapaxes(1, 2)),
        lump_Q=along,
        lump_dQ=_by_centres(rest, carried[COMPLIANT], a[:, COMPLIANT]),
        X_RT=rest.frames.X_RF[5] @ add_batch_axis(X_FT),
    )


def screw_derivatives(
    deflection: DeflectionDerivatives, dQ_dx: Array, direct: Array, screw_dx: Array
) -> Array:
    """Compute the screws of T in its own axes per unit of each parameter, (6, n, p).

    Args:
        dQ_dx: Derivatives of loads [N m, N] by parameters, without the screws of frames, (d, n, p).
        direct: Direct derivatives of joint angles [rad] and strains [rad, m] by parameters, (d, n, p).
        screw_dx: Derivatives of the frames' screws [rad, m] by parameters, (s, p).
    """
    inner = deflection.dQ[:, COMPLIANT, COMPLIANT]
    loads = np.moveaxis(dQ_dx, 1, 0) + deflection.dQ[:, COMPLIANT, SCREW:] @ screw_dx
    response = np.linalg.solve(
        np.eye(SCREW) - deflection.C @ inner, deflection.C @ loads + np.moveaxis(direct, 1, 0)
    )
    S = np.moveaxis(deflection.S, -1, 0)
    twist_R = S[:, COMPLIANT].swapaxes(1, 2) @ response + S[:, SCREW:].swapaxes(1, 2) @ screw_dx
    to_T = np.moveaxis(adjoint(inverse(deflection.X_RT)), -1, 0)
    return np.moveaxis(to_T @ twist_R, 0, 1)


def _screws(arm: Arm, rest: Equilibrium, X_FT: Pose) -> tuple[Array, Integers]:
    """Compute the screws (COORDINATE_COUNT, 6, n) of the coordinates, and their positions along the arm."""
    frames, n = rest.frames, rest.output_rad.shape[-1]
    R_RL, p_RL = frames.X_RL.R, frames.X_RL.p
    S, position = np.zeros((COORDINATE_COUNT, 6, n)), np.zeros(COORDINATE_COUNT, int)
    for joint in range(JOINT_COUNT):
        S[TURN + joint] = _about(R_RL[:, 2, joint + 1], p_RL[:, joint + 1])
        position[TURN + joint] = LINK * (joint + 1)
    for link in range(LINK_COUNT):
        at = STRAIN + 6 * link
        X_LD, R = frames.X_LD[link], R_RL[:, :, link]
        spring = np.einsum("ijn,jn->in", R, X_LD.p) + p_RL[:, link]
        x = rest.strain[0, link]
        y_L = np.array([np.zeros(n), np.cos(x), np.sin(x)])
        axes_R = (R[:, 0], np.einsum("ijn,jn->in", R, y_L), np.einsum("ijn,jn->in", R, X_LD.R[:, 2]))
        for k in range(3):
            S[at + k] = _about(axes_R[k], spring)
            S[at + 3 + k, 3:] = R[:, k]
        position[at : at + 6] = LINK * link + SPRING + np.array([3, 4, 5, 0, 1, 2])
    X_RF = frames.X_RF
    X_RT = X_RF[5] @ add_batch_axis(X_FT)
    for frame in range(LINK_COUNT + 1):
        X = X_RT if frame == LINK_COUNT else X_RF[frame]
        position[SCREW + 6 * frame : SCREW + 6 * frame + 6] = LINK * frame + END
        if frame == 0:  # the rover's spring and bracket move with this frame
            X = frames.X_RL[0] @ Pose(np.eye(3)[:, :, None], arm.p_LC_m[:, :1]) @ arm.X_CF[[0]]
            position[SCREW : SCREW + 6] = 0
        if frame == 5:  # the turret's mass moves with this frame
            position[SCREW + 30 : SCREW + 36] = LINK * frame + ON_FAR
        S[SCREW + 6 * frame : SCREW + 6 * frame + 6] = adjoint(X).swapaxes(0, 1)
    return S, position


def _about(axis: Array, point: Array) -> Array:
    """Compute the screws of rotations about axes through points, shape (6, n)."""
    return np.concatenate([axis, cross(point, axis)])


def _lumps(arm: Arm, rest: Equilibrium) -> tuple[Array, Array]:
    """Compute the positions of near and far lumps in the rover frame, shape (3, LINK_COUNT, n) each."""
    X_RL, X_LD = rest.frames.X_RL, rest.frames.X_LD
    near = np.einsum("ijln,jl->iln", X_RL.R, arm.near_p_L_m) + X_RL.p
    far_L = np.einsum("ijln,jl->iln", X_LD.R, arm.far_p_C_m) + X_LD.p
    return near, np.einsum("ijln,jln->iln", X_RL.R, far_L) + X_RL.p


def _velocity(S: Array, p: Array) -> Array:
    """Compute velocities (c, 3, 2, LINK_COUNT, n) of points (2, 3, LINK_COUNT, n) along screws (c, 6, n)."""
    w = S[:, :3].swapaxes(0, 1)[:, :, None, None]
    v = S[:, 3:][:, :, None, None]
    turning: Array = cross(w, p.swapaxes(0, 1)[:, None]).swapaxes(0, 1)
    return turning + v


def _by_centres(rest: Equilibrium, carried: Array, g_x_w: Array) -> Array:
    """Compute the derivatives of loads by the centres of mass: m (g x w).(R e)."""
    R_RL, R_LD = rest.frames.X_RL.R, rest.frames.X_LD.R
    sides = np.stack([R_RL, np.einsum("ijln,jkln->ikln", R_RL, R_LD)])
    return np.asarray(np.einsum("csl,icn,sikln->cslkn", carried, g_x_w, sides, optimize=True))


def _compliance(arm: Arm) -> Array:
    C = np.zeros((SCREW, SCREW))
    C[range(JOINT_COUNT), range(JOINT_COUNT)] = 1.0 / arm.gear_stiffness_Nm_rad
    for link in range(LINK_COUNT):
        at = slice(STRAIN + 6 * link, STRAIN + 6 * link + 6)
        C[at, at] = arm.compliance[:, :, link]
    return C


def add_batch_axis(X: Pose) -> Pose:
    """Make a pose a batch (1,)."""
    return Pose(X.R[:, :, None], X.p[:, None])

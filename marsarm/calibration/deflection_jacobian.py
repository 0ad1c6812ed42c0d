"""Exact derivatives of the last frame of a deflected arm by the parameters of the arm.

Coordinates are joint angles, strains of springs and small screws of frames. Coordinate c moves all bodies
beyond it along a screw S_c = (w, v) in rover axes. With the gravity potential V = -sum(m g.p),

    Q_a = -dV/da = sum(m g.(w_a x p + v_a)),    dQ_a/db = (g x w_a).(w_b x M_b + m_b v_b)   (a before b)

with the mass m_b and its first moment M_b beyond the outer coordinate. Strains and wind-up follow the load,
y = C Q(y, x) + ..., so the implicit function theorem gives their response to a parameter x:

    (1 - C dQ/dy) dy/dx = C dQ/dx + the direct derivative of y by x.
"""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.statics import Equilibrium
from fsw.kinematics.transforms import Array, Integers, Pose, adjoint, cross, inverse

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
        gravity_R_m_s2: Gravity in the rover frame, (3, n).
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

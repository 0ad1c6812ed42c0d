"""How a hanging arm's last frame moves with the numbers that the arm is made of: exact derivatives.

Every angle of a joint, every strain of a spring and every small screw of a frame is a coordinate c that moves
all beyond it along a screw S_c = (w, v) in rover axes. Of the gravity potential V = -sum(m g.p),

    Q_a = -dV/da = sum(m g.(w_a x p + v_a)),    dQ_a/db = (g x w_a).(w_b x M_b + m_b v_b)   (a before b)

with the mass m_b and its moment M_b beyond the coordinate farther out. Strains and wind-up follow the load,
y = C Q(y, x) + ..., so their own response to a parameter x is that of the implicit function:

    (1 - C dQ/dy) dy/dx = C dQ/dx + what x does to y directly.
"""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.statics import Equilibrium
from fsw.kinematics.transforms import Array, Integers, Pose, adjoint, cross, inverse

LINK_COUNT, JOINT_COUNT = 6, 5
TURN, STRAIN, SCREW = 0, JOINT_COUNT, JOINT_COUNT + 6 * LINK_COUNT
"""Where each kind of coordinate begins: joint angles, strains of the springs, screws of the frames."""
COORDINATE_COUNT = SCREW + 6 * (LINK_COUNT + 1)
COMPLIANT = slice(0, SCREW)
"""The coordinates that follow the load."""
LINK, NEAR, SPRING, ON_FAR, FAR, END = 100, 10, 20, 29, 30, 40
"""Places along a link: its joint at 0, then the near lump, the spring's six, the far lump, the next frame."""


@dataclass(frozen=True, slots=True, eq=False)
class DeflectionDerivatives:
    """The arm at rest, and what moves it; batch last."""

    arm: Arm
    rest: Equilibrium
    S: Array
    """Screws of all coordinates in rover axes, (COUNT, 6, n)."""
    C: Array
    """What the yielding coordinates give for their loads, (SCREW, SCREW)."""
    dQ: Array
    """Loads of the coordinates by the coordinates, (n, COUNT, COUNT)."""
    lump_Q: Array
    """The loads that near and far lumps put on the yielding coordinates, (SCREW, 2, LINKS, n)."""
    lump_dQ: Array
    """Those by shifts of the lumps' centres in link axes, (SCREW, 2, LINKS, 3, n)."""
    X_RT: Pose
    """The frame whose motion is asked for."""


def differentiate_deflection(
    arm: Arm, rest: Equilibrium, gravity_R_m_s2: Array, X_FT: Pose
) -> DeflectionDerivatives:
    """Everything that derivatives take, at rest poses (n) under gravity (3, n), of a frame T on Arm6."""
    S, place = _screws(arm, rest, X_FT)
    near, far = _lumps(arm, rest)
    kg = np.stack([arm.near_kg, arm.far_kg])
    lumps = np.stack([near, far])  # side, xyz, link, n
    # a coordinate carries a lump if it stands before it
    lump_place = LINK * np.arange(LINK_COUNT) + np.array([[NEAR], [FAR]])
    carried = (place[:, None, None] < lump_place) * kg
    m = carried.sum(axis=(1, 2))
    M = np.einsum("csl,sxln->cxn", carried, lumps)
    a = cross(gravity_R_m_s2[:, None], S[:, :3].swapaxes(0, 1))
    b = cross(S[:, :3].swapaxes(0, 1), M.swapaxes(0, 1)) + m[:, None] * S[:, 3:].swapaxes(0, 1)
    h = np.moveaxis(a, -1, 0).swapaxes(1, 2) @ np.moveaxis(b, -1, 0)
    first = place[:, None] <= place
    y = S[COMPLIANT]
    along = np.einsum("csl,xn,cxsln->csln", carried[COMPLIANT], gravity_R_m_s2, _velocity(y, lumps))
    return DeflectionDerivatives(
        arm=arm,
        rest=rest,
        S=S,
        C=_compliance(arm),
        dQ=np.where(first, h, h.swapaxes(1, 2)),
        lump_Q=along,
        lump_dQ=_by_centres(rest, carried[COMPLIANT], a[:, COMPLIANT]),
        X_RT=rest.frames.X_RF[5] @ add_batch_axis(X_FT),
    )


def screw_derivatives(hang: DeflectionDerivatives, dQ_dx: Array, direct: Array, screw_dx: Array) -> Array:
    """The screw of T in its own axes by parameters, (6, n, p).

    `dQ_dx` (SCREW, n, p): what the parameters do to the loads, beyond what the frames' screws do, which
    `screw_dx` (6 (LINKS + 1), p) gives; `direct` (SCREW, n, p): to strains and joint angles themselves.
    """
    inner = hang.dQ[:, COMPLIANT, COMPLIANT]
    loads = np.moveaxis(dQ_dx, 1, 0) + hang.dQ[:, COMPLIANT, SCREW:] @ screw_dx
    moved = np.linalg.solve(np.eye(SCREW) - hang.C @ inner, hang.C @ loads + np.moveaxis(direct, 1, 0))
    S = np.moveaxis(hang.S, -1, 0)
    twist_R = S[:, COMPLIANT].swapaxes(1, 2) @ moved + S[:, SCREW:].swapaxes(1, 2) @ screw_dx
    to_T = np.moveaxis(adjoint(inverse(hang.X_RT)), -1, 0)
    return np.moveaxis(to_T @ twist_R, 0, 1)


def _screws(arm: Arm, rest: Equilibrium, X_FT: Pose) -> tuple[Array, Integers]:
    """Screws (COUNT, 6, n) of the coordinates, and the place of each along the arm, a whole number."""
    frames, n = rest.frames, rest.output_rad.shape[-1]
    R_RL, p_RL = frames.X_RL.R, frames.X_RL.p
    S, place = np.zeros((COORDINATE_COUNT, 6, n)), np.zeros(COORDINATE_COUNT, int)
    for joint in range(JOINT_COUNT):
        S[TURN + joint] = _about(R_RL[:, 2, joint + 1], p_RL[:, joint + 1])
        place[TURN + joint] = LINK * (joint + 1)
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
        place[at : at + 6] = LINK * link + SPRING + np.array([3, 4, 5, 0, 1, 2])
    X_RF = frames.X_RF
    last = X_RF[5] @ add_batch_axis(X_FT)
    for frame in range(LINK_COUNT + 1):
        X = last if frame == LINK_COUNT else X_RF[frame]
        place[SCREW + 6 * frame : SCREW + 6 * frame + 6] = LINK * frame + END
        if frame == 0:  # the rover's spring and bracket sit at the frame and move with it
            X = frames.X_RL[0] @ Pose(np.eye(3)[:, :, None], arm.p_LC_m[:, :1]) @ arm.X_CF[[0]]
            place[SCREW : SCREW + 6] = 0
        if frame == 5:  # and so does the turret's mass
            place[SCREW + 30 : SCREW + 36] = LINK * frame + ON_FAR
        S[SCREW + 6 * frame : SCREW + 6 * frame + 6] = adjoint(X).swapaxes(0, 1)
    return S, place


def _about(axis: Array, point: Array) -> Array:
    """The screws (6, n) of turns about axes through points (3, n)."""
    return np.concatenate([axis, cross(point, axis)])


def _lumps(arm: Arm, rest: Equilibrium) -> tuple[Array, Array]:
    """Where near and far lumps are in the rover frame, (3, LINKS, n) each."""
    X_RL, X_LD = rest.frames.X_RL, rest.frames.X_LD
    near = np.einsum("ijln,jl->iln", X_RL.R, arm.near_p_L_m) + X_RL.p
    far_L = np.einsum("ijln,jl->iln", X_LD.R, arm.far_p_C_m) + X_LD.p
    return near, np.einsum("ijln,jln->iln", X_RL.R, far_L) + X_RL.p


def _velocity(S: Array, p: Array) -> Array:
    """Of points (2, 3, LINKS, n) along screws (c, 6, n): (c, 3, 2, LINKS, n)."""
    w = S[:, :3].swapaxes(0, 1)[:, :, None, None]
    v = S[:, 3:][:, :, None, None]
    turning: Array = cross(w, p.swapaxes(0, 1)[:, None]).swapaxes(0, 1)
    return turning + v


def _by_centres(rest: Equilibrium, carried: Array, g_x_w: Array) -> Array:
    """Loads by shifts of centres: m (g x w).(R e)."""
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
    """One pose beside many."""
    return Pose(X.R[:, :, None], X.p[:, None])

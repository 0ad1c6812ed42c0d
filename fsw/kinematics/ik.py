"""Inverse kinematics: every branch of a target, with its angles or the reason that it is out.

The closed form gives the roots of the square rigid arm. Where the arm is not square, or hangs under gravity,
Newton steps finish them. Every root is checked by forward kinematics, and only limits reject a root.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from fsw.dictionary.joints import Joint
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import BRANCHES, Roots, closed_form
from fsw.kinematics.compensation import task_error
from fsw.kinematics.finish import Finish, Flags, Numbers
from fsw.kinematics.limits import beyond_limits, into_limits, outside
from fsw.kinematics.transforms import Array, wrap_angle


class Verdict(IntEnum):
    """Why a branch is in or out."""

    VALID = 0
    OUTSIDE_LIMITS = 1
    OUT_OF_REACH = 2
    SINGULAR = 3
    """The approach is parallel to the pitch axes: the wrist pitch is free, a family with one parameter."""
    NOT_CONVERGED = 4


ROOT_TOLERANCE: Final = 1e-9
"""Forward check of a root: position [m] and axis [rad]."""
SINGULAR_SINE: Final = 1e-7
CAPTURE_M: Final = 0.03
"""How far out of the square arm's reach the real arm may still reach: deflection and calibration."""
CAPTURE_RAD: Final = 0.08
"""How far outside the limits a root of the rigid arm may be and still come in under deflection."""
START_BEND_RAD: Final = 0.15
"""Newton starts keep the elbow this far from its double roots, and there renew the Jacobian in every step."""
CHUNK: Final = 2048
"""Targets at a time, to bound the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """The eight branches of each target in the order of BRANCHES, batch axes trailing."""

    output_rad: Array
    """(5, 8, ...), in the turn that the limits allow; NaN where there is no root."""
    torque_Nm: Array
    """(5, 8, ...), of gravity on each output; 0 for the rigid arm."""
    verdict: Numbers
    """(8, ...), of Verdict."""
    joint: Numbers
    """(8, ...), of Joint: the one farthest beyond its limit; meaningful for OUTSIDE_LIMITS."""
    excess: Array
    """(8, ...): by how much a branch is out: radians over the limit, or metres out of reach; else 0."""
    error: Array
    """(8, ...): forward check, the larger of position error [m] and axis error [rad]; NaN without a root."""


def inverse_kinematics(
    arm: Arm,
    tool: int,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array | None = None,
    near_rad: Array | None = None,
) -> Answers:
    """All branches for positions (3, ...) and unit approach vectors (3, ...), in the rover frame RMECH.

    With gravity (3,) the deflected tool meets the target, without it the rigid one. Where limits allow two
    turns of a joint, the one nearest to `near_rad` (5,) is taken, or to the middle of the range.
    """
    targets = p_RoTo_R_m.shape[1:]
    p, a = p_RoTo_R_m.reshape(3, -1), approach_R.reshape(3, -1)
    pieces = [
        _inverse(arm, tool, p[:, k : k + CHUNK], a[:, k : k + CHUNK], gravity_R_m_s2, near_rad)
        for k in range(0, p.shape[1], CHUNK)
    ]
    joined = {
        name: np.concatenate([getattr(piece, name) for piece in pieces], axis=-1)
        for name in Answers.__slots__
    }
    return Answers(**{name: values.reshape(*values.shape[:-1], *targets) for name, values in joined.items()})


def _inverse(
    arm: Arm, tool: int, p_m: Array, approach: Array, gravity_R_m_s2: Array | None, near_rad: Array | None
) -> Answers:
    """inverse_kinematics for targets (3, n)."""
    roots = closed_form(arm, tool, p_m, approach)
    shape_of = roots.output_rad.shape
    flat = _flattened(roots)
    p, a = (np.broadcast_to(v[:, None], (3, *shape_of[1:])).reshape(3, -1) for v in (p_m, approach))
    q, torque = flat.output_rad.copy(), np.zeros_like(flat.output_rad)
    singular = flat.wrist_sine < SINGULAR_SINE
    if gravity_R_m_s2 is None:
        error = _forward_error(arm, tool, q, p, a)
        found = error < ROOT_TOLERANCE
        wanted = np.zeros_like(found) if arm.shapes[tool].is_exact else ~found & (flat.missing_m < CAPTURE_M)
        tried = wanted
    else:
        error, found = np.full(q.shape[1], np.nan), np.zeros(q.shape[1], bool)
        tried = flat.missing_m < CAPTURE_M
        rigid_over = beyond_limits(arm, into_limits(arm, q, near_rad)).max(axis=0)
        wanted = tried & (rigid_over < CAPTURE_RAD) & ~singular
    if wanted.any():
        finish = Finish(arm, tool, p, a, np.zeros(3) if gravity_R_m_s2 is None else gravity_R_m_s2)
        close = _close_to_fold(arm, tool, flat)
        start = flat.output_rad
        if (wanted & close).any():
            off = _flattened(closed_form(arm, tool, p_m, approach, START_BEND_RAD))
            start = np.where(close, off.output_rad, start)
        done = finish(start, wanted, close, shape_of)
        q = np.where(done.found, done.output_rad, q)
        torque, error, found = done.torque_Nm, np.where(wanted, done.error, error), found | done.found
    q = into_limits(arm, q, near_rad)
    return _judged(arm, q, torque, flat, found, tried & ~wanted, singular, error, shape_of)


def why(arm: Arm, answers: Answers, branch: int) -> str:
    """The sentence about one branch of a single target."""
    name, verdict, excess = BRANCHES[branch], Verdict(int(answers.verdict[branch])), answers.excess[branch]
    match verdict:
        case Verdict.VALID:
            return f"{name}: valid"
        case Verdict.OUTSIDE_LIMITS:
            joint = Joint(int(answers.joint[branch]))
            return f"{name}: {outside(arm, joint, answers.output_rad[joint, branch])}"
        case Verdict.OUT_OF_REACH:
            return f"{name}: out of reach by {excess:.3f} m"
        case Verdict.SINGULAR:
            return f"{name}: singular, the approach is parallel to the pitch axes and the wrist pitch is free"
        case Verdict.NOT_CONVERGED:
            return f"{name}: no answer found, {answers.error[branch]:.2g} left"


def at_target(answers: Answers, index: int) -> Answers:
    """The answers of one target of a batch (n,)."""
    return Answers(*(getattr(answers, name)[..., index] for name in Answers.__slots__))


def _flattened(roots: Roots) -> Roots:
    return Roots(roots.output_rad.reshape(5, -1), roots.missing_m.reshape(-1), roots.wrist_sine.reshape(-1))


def _forward_error(arm: Arm, tool: int, q: Array, p: Array, a: Array) -> Array:
    X_RT = tool_pose(arm, forward(arm, q), tool)
    worst: Array = np.max(np.abs(task_error(X_RT, p, a)), axis=0)
    return worst


def _close_to_fold(arm: Arm, tool: int, flat: Roots) -> Flags:
    """Roots whose elbow is nearly straight or folded, where two roots meet."""
    bend = np.abs(wrap_angle(flat.output_rad[Joint.ELBOW] + arm.shapes[tool].theta_rad[Joint.ELBOW]))
    return (bend < START_BEND_RAD) | (bend > np.pi - START_BEND_RAD)


def _judged(
    arm: Arm,
    q: Array,
    torque: Array,
    flat: Roots,
    found: Flags,
    rigid_only: Flags,
    singular: Flags,
    error: Array,
    shape_of: tuple[int, ...],
) -> Answers:
    """Verdicts; a root too far outside the limits to come in under load is judged by its rigid angles."""
    beyond = beyond_limits(arm, q)
    over, joint = beyond.max(axis=0), beyond.argmax(axis=0)
    missing = flat.missing_m > ROOT_TOLERANCE
    found = found & ~singular
    has_angles = found | (rigid_only & ~singular)
    verdict = np.full(found.shape, int(Verdict.NOT_CONVERGED))
    verdict[missing] = Verdict.OUT_OF_REACH
    verdict[singular & ~missing] = Verdict.SINGULAR
    verdict[has_angles] = Verdict.OUTSIDE_LIMITS
    verdict[found & (over <= 0)] = Verdict.VALID
    excess = np.zeros_like(over)
    excess[verdict == Verdict.OUTSIDE_LIMITS] = over[verdict == Verdict.OUTSIDE_LIMITS]
    excess[verdict == Verdict.OUT_OF_REACH] = flat.missing_m[verdict == Verdict.OUT_OF_REACH]
    batch = shape_of[1:]
    return Answers(
        np.where(has_angles, q, np.nan).reshape(shape_of),
        torque.reshape(shape_of),
        verdict.reshape(batch),
        joint.reshape(batch),
        excess.reshape(batch),
        np.where(found | (verdict == Verdict.NOT_CONVERGED), error, np.nan).reshape(batch),
    )

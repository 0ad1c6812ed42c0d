"""Inverse kinematics of the arm for a position and an approach: every branch of a target.

The result has for every branch its joint angles, or the reason that it has none. The closed form gives the
roots of the orthogonal rigid arm. If the arm is not orthogonal, or deflects under gravity, the fixed-point
iteration leads from each of them to the root of the real arm; Newton's method does where the elbow is nearly
straight. Forward kinematics checks every root. Only limits reject a root.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import (
    Arm,
    describe_estimated_outside,
    describe_outside,
    format_digits,
    limit_excess,
    wrap_into_limits,
)
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import BRANCHES, FREE_SINE, Roots, closed_form
from fsw.kinematics.roots import (
    CLEAR_OF_FOLD,
    FixedPointRoots,
    FixedPointSearch,
    NewtonRoots,
    NewtonSearch,
    begin_fixed_point,
    begin_straight,
    find_straight,
    keep_on_side,
)
from fsw.kinematics.statics import ROOT_TOLERANCE, task_error
from fsw.kinematics.transforms import (
    Array,
    Flags,
    Integers,
    concatenate_records,
    norm,
    record_arrays,
    wrap_angle,
)

NEGLIGIBLE_M: Final = 1e-6
"""A target out of reach by less than this is at the edge of reach."""
ROUNDED_M: Final = 1e-10
"""The same bound for rounding, to be divided by the sine of the wrist.

The smaller the sine, the more the wrist turns for the same error.
"""
REGULAR_SINE: Final = 0.1
"""Sine between approach and pitch axes of a regular approach.

Of two million targets in the workspace of twenty calibrated arms, none with a larger sine lost a root.
"""
TURNS: Final = 5
"""Iterations of the regular approach; its azimuth changes by about a tenth of the turn."""
CHUNK: Final = 1024
"""Targets per chunk of the fixed-point iteration, to bound the memory."""
EXACT_CHUNK: Final = 256
"""Targets per chunk of the closed form alone; chosen for the processor cache."""
SAME_RAD: Final = 1e-4
"""Roots closer than this are one root."""
NEAR_LIMITS_RAD: Final = 0.35
"""Excess over the limits up to which a root of the orthogonal arm is considered."""
SINGULAR_JOINTS: Final = np.array([Joint.AZIMUTH, Joint.ELBOW, Joint.WRIST])
"""Joints of the folds, in the order of fold_distances."""


class BranchVerdict(IntEnum):
    """Verdict on a slot: a valid root, or the reason that there is none."""

    VALID = 0
    OUTSIDE_LIMITS = 1
    OUT_OF_REACH = 2
    SINGULAR = 3
    """Close to a singularity: a family of poses of the rigid arm, or no pose found of the real arm."""


@dataclass(frozen=True, slots=True, eq=False)
class IkResult:
    """Branches of each target in the order of BRANCHES, batch axes trailing.

    A root has the slot of the orthogonal arm's root from which it was found. Very close to singularities, a
    branch of the real arm may have further roots, which are not searched.
    """

    output_rad: Array
    """Output angles, (5, 8, ...), with the whole turns that the limits allow.

    NaN if there is no root, or if a root of the real arm is so far outside the limits that it was not
    followed.
    """
    torque_Nm: Array
    """Torque of gravity on each output, (5, 8, ...); 0 for the rigid arm."""
    verdict: Integers
    """Values of BranchVerdict, (8, ...)."""
    joint: Integers
    """Values of Joint, (8, ...).

    The joint farthest beyond its limit (OUTSIDE_LIMITS), or the joint of the fold (SINGULAR).
    """
    excess: Array
    """Measure of the verdict, (8, ...): rad over the limit, m out of reach, or distance from the
    singularity.

    That distance is in m (AZIMUTH) or a sine. All other verdicts have 0.
    """
    error: Array
    """Largest component of position error [m] and axis error [rad] in the forward check, (8, ...).

    NaN if there are no angles.
    """


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Roots in the slots of their branches; NaN where there is none."""

    output_rad: Array
    """Output angles, (5, 8, n)."""
    torque_Nm: Array
    """Torque of the load on each output, (5, 8, n)."""
    error: Array
    """Larger of position error [m] and axis error [rad], (8, n)."""


@dataclass(frozen=True, slots=True, eq=False)
class _Reasons:
    """Reason for a missing root of each slot: verdict, joint and excess as in IkResult, (8, n) each."""

    verdict: Integers
    joint: Integers
    excess: Array


def inverse_kinematics(
    arm: Arm,
    tool: str,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array | None = None,
    near_rad: Array | None = None,
) -> IkResult:
    """Compute all branches of the inverse kinematics.

    The same targets in the same batch give the same bits. In another batch they may differ by 1e-12 rad, and
    next to double roots by the tolerance of the forward check.

    Args:
        gravity_R_m_s2: Gravity in the rover frame, shape (3,); None for the rigid arm.
        near_rad: Output angles to stay near if the limits allow two turns of a joint, shape (5,); None for
            the middle of the limits.
    """
    targets = p_RoTo_R_m.shape[1:]
    p, a = p_RoTo_R_m.reshape(3, -1), approach_R.reshape(3, -1)
    gravity = np.zeros(3) if gravity_R_m_s2 is None else gravity_R_m_s2
    size = EXACT_CHUNK if _is_exact(arm, tool, gravity) else CHUNK
    chunks = []
    for k in (slice(first, first + size) for first in range(0, max(p.shape[1], 1), size)):
        search = begin_search(arm, tool, p[:, k], a[:, k], gravity, near_rad)
        while isinstance(search, IkSearch):
            search = search.advance()
        chunks.append(search)
    result = concatenate_records(chunks)
    return IkResult(*(v.reshape(*v.shape[:-1], *targets) for v in record_arrays(result)))


def begin_search(
    arm: Arm,
    tool: str,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array,
    near_rad: Array | None = None,
) -> "IkSearch | IkResult":
    """Begin what `inverse_kinematics` does, to be advanced piece by piece; the closed form may be all of it.

    Args:
        p_RoTo_R_m: Positions of targets in m, shape (3, n).
        approach_R: Approach directions, unit vectors, shape (3, n).
        near_rad: As in `inverse_kinematics`, shape (5,) in rad.
    """
    roots = closed_form(arm, tool, p_RoTo_R_m, approach_R)
    if _is_exact(arm, tool, gravity_R_m_s2):
        X_RT = tool_pose(arm, forward(arm, roots.output_rad), tool)
        error = np.max(np.abs(task_error(X_RT, p_RoTo_R_m[:, None], approach_R[:, None])), axis=0)
        found = (error < ROOT_TOLERANCE) & (roots.wrist_sine >= FREE_SINE)
        output = np.where(found, roots.output_rad, np.nan)
        return _classify(arm, _Found(output, np.zeros_like(output), error), _find_reasons(roots), near_rad)
    each = roots.missing_m.shape
    start = roots.output_rad.reshape(5, -1)
    p8, a8 = (np.broadcast_to(v[:, None], (3, *each)).reshape(3, -1) for v in (p_RoTo_R_m, approach_R))
    near_limits = limit_excess(arm, wrap_into_limits(arm, start)).max(axis=0) < NEAR_LIMITS_RAD
    in_reach = roots.missing_m.reshape(-1) == 0
    fold_distance = roots.from_fold.reshape(3, -1).min(axis=0)
    fixed_point = begin_fixed_point(
        arm, tool, p8, a8, gravity_R_m_s2, start, fold_distance, in_reach & near_limits
    )
    straight = find_straight(roots) & near_limits.reshape(each)
    newton = (
        begin_straight(arm, tool, p_RoTo_R_m, approach_R, gravity_R_m_s2, straight)
        if straight.any()
        else None
    )
    return IkSearch(arm, tool, p_RoTo_R_m, approach_R, near_rad, roots, fixed_point, straight, newton)


def _is_exact(arm: Arm, tool: str, gravity_R_m_s2: Array) -> bool:
    """Return whether the arm is the orthogonal rigid one, which the closed form solves."""
    return bool(arm.orthogonal[tool].is_exact and not gravity_R_m_s2.any())


@dataclass(frozen=True, slots=True, eq=False)
class IkSearch:
    """Search under way for the branches of an arm that is not orthogonal, or that deflects."""

    arm: Arm
    tool: str
    p: Array
    """Targets in m, (3, n)."""
    a: Array
    """Approaches, (3, n)."""
    near_rad: Array | None
    roots: Roots
    """Roots of the orthogonal rigid arm."""
    fixed_point: FixedPointSearch | FixedPointRoots
    straight: Flags
    """Roots that are searched by Newton's method, (8, n)."""
    newton: NewtonSearch | NewtonRoots | None
    """That search; None if there are no such roots."""

    def advance(self) -> "IkSearch | IkResult":
        """Do one iteration."""
        if isinstance(self.fixed_point, FixedPointSearch):
            return replace(self, fixed_point=self.fixed_point.advance())
        if isinstance(self.newton, NewtonSearch):
            return replace(self, newton=self.newton.advance())
        return self._conclude(self.fixed_point, self.newton)

    def _conclude(self, fixed_point: FixedPointRoots, newton: NewtonRoots | None) -> "IkResult":
        """Put the roots of both iterations into the slots of their branches."""
        each = self.roots.missing_m.shape
        unfollowed = (self.roots.missing_m.reshape(-1) == 0) & ~fixed_point.followed
        reasons = _mark_outside(
            self.arm, fixed_point.output_rad, unfollowed, _find_reasons(self.roots, FREE_SINE)
        )
        output = np.where(fixed_point.converged, fixed_point.output_rad, np.nan)
        torque, error = fixed_point.torque_Nm.copy(), fixed_point.error.copy()
        if newton is not None:
            kept = keep_on_side(self.arm, self.tool, self.p, self.a, self.straight, newton)
            straight = self.straight.reshape(-1)
            output[:, straight] = np.where(kept.converged, kept.output_rad, np.nan)
            torque[:, straight], error[straight] = kept.torque_Nm, kept.error
        output = _drop_twins(output.reshape(5, *each), self.roots)
        found = _Found(output, torque.reshape(5, *each), error.reshape(each))
        return _classify(self.arm, found, reasons, self.near_rad)


def _find_reasons(roots: Roots, least_distance: float = 0.0) -> _Reasons:
    """Find the reasons why roots are missing; a distance from a singularity is at least `least_distance`."""
    free = roots.wrist_sine < FREE_SINE
    out = roots.missing_m > NEGLIGIBLE_M + np.where(
        free, 0.0, ROUNDED_M / np.maximum(roots.wrist_sine, FREE_SINE)
    )
    verdict = np.where(out, int(BranchVerdict.OUT_OF_REACH), int(BranchVerdict.SINGULAR))
    nearest = np.where(free, int(Joint.WRIST), SINGULAR_JOINTS[np.argmin(roots.from_fold, axis=0)])
    distance = np.maximum(np.where(free, roots.wrist_sine, roots.from_fold.min(axis=0)), least_distance)
    return _Reasons(verdict, nearest, np.where(out, roots.missing_m, distance))


def _mark_outside(arm: Arm, estimate_rad: Array, outside: Flags, reasons: _Reasons) -> _Reasons:
    """Mark roots (8 n) that were not followed as outside the limits, with their estimated excess."""
    each = reasons.verdict.shape
    beyond = limit_excess(arm, wrap_into_limits(arm, estimate_rad))
    over, joint, outside = (v.reshape(each) for v in (beyond.max(axis=0), beyond.argmax(axis=0), outside))
    return _Reasons(
        np.where(outside, BranchVerdict.OUTSIDE_LIMITS, reasons.verdict),
        np.where(outside, joint, reasons.joint),
        np.where(outside, over, reasons.excess),
    )


def _drop_twins(output_rad: Array, roots: Roots) -> Array:
    """Drop a root (5, 8, n) that two slots of a target found, from the slot that started farther away."""
    close = np.flatnonzero((roots.from_fold.min(axis=0) < CLEAR_OF_FOLD).any(axis=0))
    if not close.size:
        return output_rad
    q = output_rad[:, :, close]
    moved = np.abs(wrap_angle(q - roots.output_rad[:, :, close])).max(axis=0)
    rank = np.argsort(np.argsort(moved, axis=0), axis=0)
    same = np.abs(wrap_angle(q[:, :, None] - q[:, None])).max(axis=0) < SAME_RAD
    is_twin = np.any(same & (rank[:, None] > rank), axis=1)
    q[:, is_twin] = np.nan
    output_rad[:, :, close] = q
    return output_rad


def _classify(arm: Arm, found: _Found, reasons: _Reasons, near_rad: Array | None) -> IkResult:
    """Build the result from the roots, and from the reasons for missing ones."""
    q = wrap_into_limits(arm, found.output_rad, near_rad)
    beyond = limit_excess(arm, q)
    over, joint = beyond.max(axis=0), beyond.argmax(axis=0)
    is_root = np.isfinite(over)
    outside = is_root & (over > 0)
    of_root = np.where(outside, BranchVerdict.OUTSIDE_LIMITS, BranchVerdict.VALID)
    return IkResult(
        q,
        np.where(is_root, found.torque_Nm, 0.0),
        np.where(is_root, of_root, reasons.verdict),
        np.where(is_root, joint, reasons.joint),
        np.where(is_root, np.where(outside, over, 0.0), reasons.excess),
        np.where(is_root, found.error, np.nan),
    )


def find_regular_approach(arm: Arm, tool: str, p_RoTo_R_m: Array, approach_R: Array, slot: int) -> Array:
    """Find the approach nearest to that of a target which is clear of the pitch axes.

    Args:
        slot: Branch, which gives the azimuth.

    Returns:
        Unit vector in the rover frame, shape (3,).
    """
    s, regular_R = arm.orthogonal[tool], approach_R
    for _ in range(TURNS):
        azimuth = closed_form(arm, tool, p_RoTo_R_m, regular_R).output_rad[Joint.AZIMUTH, slot]
        c, sine = np.cos(azimuth + s.theta_rad[0]), np.sin(azimuth + s.theta_rad[0])
        ahead_R, pitch_axis_R = s.X_R1.R @ (c, sine, 0.0), s.X_R1.R @ (sine, -c, 0.0)
        along = approach_R @ pitch_axis_R
        across_R = approach_R - along * pitch_axis_R
        across_R = ahead_R if norm(across_R) < FREE_SINE else across_R / norm(across_R)
        regular_R = (
            np.copysign(np.sqrt(1.0 - REGULAR_SINE**2), along) * pitch_axis_R + REGULAR_SINE * across_R
        )
    return regular_R


def describe_slot(arm: Arm, result: IkResult, slot: int) -> str:
    """Describe one slot of a single target in a sentence."""
    return f"{BRANCHES[slot]}: {_describe_verdict(arm, result, slot)}"


def _describe_verdict(arm: Arm, result: IkResult, slot: int) -> str:
    """Describe the verdict on a slot."""
    verdict, excess = BranchVerdict(int(result.verdict[slot])), float(result.excess[slot])
    match verdict:
        case BranchVerdict.VALID:
            return "valid"
        case BranchVerdict.OUTSIDE_LIMITS:
            joint = Joint(int(result.joint[slot]))
            angle = float(result.output_rad[joint, slot])
            return (
                describe_estimated_outside(arm, joint, excess)
                if np.isnan(angle)
                else describe_outside(arm, joint, angle)
            )
        case BranchVerdict.OUT_OF_REACH:
            return f"out of reach by {format_digits(excess, 3)} m"
        case BranchVerdict.SINGULAR:
            return _describe_singularity(Joint(int(result.joint[slot])), excess)


def _describe_singularity(joint: Joint, distance: float) -> str:
    """Describe a singularity by the joint of its fold and the distance from it."""
    angle_deg = np.degrees(np.arcsin(min(distance, 1.0)))
    match joint:
        case Joint.AZIMUTH:
            condition, distance_text = "the turret axis is abreast of the azimuth axis", f"{distance:.3f} m"
        case Joint.ELBOW:
            condition, distance_text = "the elbow is straight or folded", f"{angle_deg:.2f} deg"
        case _ if distance < FREE_SINE:
            return "singular, the approach is parallel to the pitch axes and the wrist pitch is free"
        case _:
            condition, distance_text = "the approach is parallel to the pitch axes", f"{angle_deg:.2f} deg"
    return f"singular, no pose: {condition}, to within {distance_text}"

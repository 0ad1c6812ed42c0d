"""Inverse kinematics of the arm for a position and an approach: every branch of a target.

The result has for every branch its joint angles, or the reason that it has none. The closed form gives the
roots of the orthogonal rigid arm. If the arm is not orthogonal, or deflects under gravity, the fixed-point
iteration leads from each of them to the root of the real arm. Close to a singularity, roots meet, part or
multiply. A grid search finds the roots of such targets. Forward kinematics checks every root. Only limits
reject a root.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm
from fsw.kinematics.batch import (
    concatenate_records,
    pad_slots,
    record_arrays,
    replace_targets,
    select_targets,
)
from fsw.kinematics.branches import slot_name
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import FREE_SINE, Roots, closed_form
from fsw.kinematics.fixed_point import FixedPointRoots, root_tolerance, solve_fixed_point
from fsw.kinematics.near_singular import FoundRoots, find_near_singular_roots
from fsw.kinematics.singularity_candidates import (
    NEAR_LIMITS_RAD,
    SingularityCandidates,
    find_singularity_candidates,
)
from fsw.kinematics.soft_limits import (
    describe_estimated_outside,
    describe_outside,
    format_digits,
    limit_excess,
    wrap_into_limits,
)
from fsw.kinematics.task import ROOT_TOLERANCE, task_error
from fsw.kinematics.transforms import Array, Flags, Integers

NEGLIGIBLE_M: Final = 1e-6
"""A target out of reach by less than this is at the edge of reach."""
ROUNDED_M: Final = 1e-10
"""The same bound for rounding, to be divided by the sine of the wrist.

The smaller the sine, the more the wrist turns for the same error.
"""
CHUNK: Final = 4096
"""Targets per chunk of the fixed-point iteration, to bound the memory."""
EXACT_CHUNK: Final = 256
"""Targets per chunk of the closed form alone; chosen for the processor cache."""
SEARCH_CHUNK: Final = 1024
"""Targets per chunk of the grid search, to bound the memory."""
SINGULAR_JOINTS: Final = np.array([Joint.AZIMUTH, Joint.ELBOW, Joint.WRIST])
"""Joints of the folds, in the order of fold_distances."""


class BranchVerdict(IntEnum):
    """Verdict on a slot: a valid root, or the reason that there is none."""

    VALID = 0
    OUTSIDE_LIMITS = 1
    OUT_OF_REACH = 2
    SINGULAR = 3
    """At a singularity of the rigid arm: a family of poses, or no pose of the real arm."""
    NOT_CONVERGED = 4
    ABSENT = 5
    """Slot for a further root of a branch that has none."""


@dataclass(frozen=True, slots=True, eq=False)
class IkResult:
    """Branches of each target, batch axes trailing.

    The first eight slots are in the order of BRANCHES. A root has the slot of the orthogonal arm's root to
    which it belongs. Very close to singularities a branch of the real arm may have several roots. A batch
    with such targets has eight more slots for the second roots, and so on.
    """

    output_rad: Array
    """Output angles, (5, slots, ...), with the whole turns that the limits allow.

    NaN if there is no root, or if a root of the real arm is so far outside the limits that it was not
    followed.
    """
    torque_Nm: Array
    """Torque of gravity on each output, (5, slots, ...); 0 for the rigid arm."""
    verdict: Integers
    """Values of BranchVerdict, (slots, ...)."""
    joint: Integers
    """Values of Joint, (slots, ...).

    The joint farthest beyond its limit (OUTSIDE_LIMITS), or the joint of the fold (SINGULAR).
    """
    excess: Array
    """Measure of the verdict, (slots, ...): rad over the limit, m out of reach, or distance from the
    singularity.

    That distance is in m (AZIMUTH) or a sine. All other verdicts have 0.
    """
    error: Array
    """Largest component of position error [m] and axis error [rad] in the forward check, (slots, ...).

    NaN if there are no angles.
    """


@dataclass(frozen=True, slots=True, eq=False)
class _Reasons:
    """Reason for a missing root of each slot: verdict, joint and excess as in IkResult, (slots, n) each."""

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
        arm: Arm.
        tool: Name of the tool.
        p_RoTo_R_m: Target positions in the rover frame RMECH, shape (3, ...).
        approach_R: Approach directions, unit vectors in the rover frame, shape (3, ...).
        gravity_R_m_s2: Gravity in the rover frame, shape (3,); None for the rigid arm.
        near_rad: Output angles to stay near if the limits allow two turns of a joint, shape (5,); None for
            the middle of the limits.

    Returns:
        The branches of each target.
    """
    targets = p_RoTo_R_m.shape[1:]
    if np.prod(targets) > EXACT_CHUNK:
        _keep_freed_memory()
    p, a = p_RoTo_R_m.reshape(3, -1), approach_R.reshape(3, -1)
    gravity = np.zeros(3) if gravity_R_m_s2 is None else gravity_R_m_s2
    if arm.orthogonal[tool].is_exact and not gravity.any():
        result = _solve_exact(arm, tool, p, a, near_rad)
    else:
        result = _solve_real(arm, tool, p, a, gravity, near_rad)
    return IkResult(*(v.reshape(*v.shape[:-1], *targets) for v in record_arrays(result)))


def _keep_freed_memory() -> None:
    """Free one large array, so that the C library keeps freed memory from then on.

    Otherwise it returns the memory of every intermediate result to the system and fetches it again. Batches
    then take up to twice as long. The array is never touched, so it costs nothing.
    """
    np.empty(31 * 2**20, np.uint8)


def _chunks(n: int, size: int) -> Iterator[slice]:
    """Yield slices of at most `size` targets; at least one slice."""
    return (slice(k, k + size) for k in range(0, max(n, 1), size))


def _solve_exact(arm: Arm, tool: str, p: Array, a: Array, near_rad: Array | None) -> IkResult:
    """Solve the orthogonal rigid arm for targets (3, n)."""
    return concatenate_results(
        [_solve_exact_chunk(arm, tool, p[:, k], a[:, k], near_rad) for k in _chunks(p.shape[1], EXACT_CHUNK)]
    )


def _solve_exact_chunk(arm: Arm, tool: str, p: Array, a: Array, near_rad: Array | None) -> IkResult:
    """Solve the orthogonal rigid arm for one chunk of targets."""
    roots = closed_form(arm, tool, p, a)
    X_RT = tool_pose(arm, forward(arm, roots.output_rad), tool)
    error = np.max(np.abs(task_error(X_RT, p[:, None], a[:, None])), axis=0)
    found = (error < ROOT_TOLERANCE) & (roots.wrist_sine >= FREE_SINE)
    output = np.where(found, roots.output_rad, np.nan)
    return _classify(arm, FoundRoots(output, np.zeros_like(output), error), _find_reasons(roots), near_rad)


def _solve_real(arm: Arm, tool: str, p: Array, a: Array, gravity: Array, near_rad: Array | None) -> IkResult:
    """Solve the arm that is not orthogonal, or that deflects, for targets (3, n)."""
    chunks = [_solve_real_chunk(arm, tool, p[:, k], a[:, k], gravity) for k in _chunks(p.shape[1], CHUNK)]
    found, reasons, candidates = (concatenate_records(parts) for parts in zip(*chunks, strict=True))
    result = _classify(arm, found, reasons, near_rad)
    close = np.flatnonzero(candidates.is_candidate.any(axis=0))
    for at in np.split(close, range(SEARCH_CHUNK, close.size, SEARCH_CHUNK)) if close.size else ():
        selected = select_targets(candidates, at)
        near = find_near_singular_roots(
            arm, tool, p[:, at], a[:, at], gravity, selected, select_targets(found, at)
        )
        result = replace_results(
            result, at, _classify(arm, near, _mark_rootless(selected, select_targets(reasons, at)), near_rad)
        )
    return result


def _solve_real_chunk(
    arm: Arm, tool: str, p: Array, a: Array, gravity: Array
) -> tuple[FoundRoots, _Reasons, SingularityCandidates]:
    """Find the fixed-point roots, the reasons for missing ones, and the singularity candidates."""
    roots = closed_form(arm, tool, p, a)
    each = roots.missing_m.shape
    start, missing = roots.output_rad.reshape(5, -1), roots.missing_m.reshape(-1)
    p8, a8 = (np.broadcast_to(v[:, None], (3, *each)).reshape(3, -1) for v in (p, a))
    over = limit_excess(arm, wrap_into_limits(arm, start)).max(axis=0)
    fold_distance = roots.from_fold.reshape(3, -1).min(axis=0)
    fixed_point = solve_fixed_point(
        arm, tool, p8, a8, gravity, start, fold_distance, (missing == 0) & (over < NEAR_LIMITS_RAD)
    )
    output = np.where(fixed_point.error < root_tolerance(gravity), fixed_point.output_rad, np.nan)
    found = FoundRoots(
        output.reshape(5, *each), fixed_point.torque_Nm.reshape(5, *each), fixed_point.error.reshape(each)
    )
    reasons = _mark_outside(arm, fixed_point, missing == 0, _find_reasons(roots))
    return found, reasons, find_singularity_candidates(arm, tool, p8, a8, roots, fixed_point, over, gravity)


def _find_reasons(roots: Roots) -> _Reasons:
    """Find the reasons why roots of the orthogonal arm are missing."""
    free = roots.wrist_sine < FREE_SINE
    out = roots.missing_m > NEGLIGIBLE_M + np.where(
        free, 0.0, ROUNDED_M / np.maximum(roots.wrist_sine, FREE_SINE)
    )
    singular = free | (roots.missing_m > ROOT_TOLERANCE)  # reach within rounding: two roots meet
    verdict = np.full(out.shape, int(BranchVerdict.NOT_CONVERGED))
    verdict[singular], verdict[out] = BranchVerdict.SINGULAR, BranchVerdict.OUT_OF_REACH
    nearest = np.where(free, int(Joint.WRIST), SINGULAR_JOINTS[np.argmin(roots.from_fold, axis=0)])
    at_singularity = np.where(singular, np.where(free, roots.wrist_sine, roots.from_fold.min(axis=0)), 0.0)
    return _Reasons(verdict, nearest, np.where(out, roots.missing_m, at_singularity))


def _mark_outside(arm: Arm, fixed_point: FixedPointRoots, reached: Flags, reasons: _Reasons) -> _Reasons:
    """Mark roots that were not followed as outside the limits, with their estimated excess."""
    beyond = limit_excess(arm, wrap_into_limits(arm, fixed_point.output_rad))
    outside = (reached & ~fixed_point.followed).reshape(reasons.verdict.shape)
    over, joint = (v.reshape(outside.shape) for v in (beyond.max(axis=0), beyond.argmax(axis=0)))
    return _Reasons(
        np.where(outside, BranchVerdict.OUTSIDE_LIMITS, reasons.verdict),
        np.where(outside, joint, reasons.joint),
        np.where(outside, over, reasons.excess),
    )


def _mark_rootless(candidates: SingularityCandidates, reasons: _Reasons) -> _Reasons:
    """Mark candidates without a root as singular: their root met another one and vanished."""
    distance = candidates.from_fold
    nearest = SINGULAR_JOINTS[np.argmin(distance, axis=0)]
    rootless = (reasons.verdict == BranchVerdict.NOT_CONVERGED) | (reasons.verdict == BranchVerdict.SINGULAR)
    vanished = candidates.is_candidate & rootless
    return _Reasons(
        np.where(vanished, BranchVerdict.SINGULAR, reasons.verdict),
        np.where(vanished, nearest, reasons.joint),
        np.where(vanished, np.maximum(distance.min(axis=0), FREE_SINE), reasons.excess),
    )


def _classify(arm: Arm, found: FoundRoots, reasons: _Reasons, near_rad: Array | None) -> IkResult:
    """Build the result from the roots, and from the reasons for missing ones."""
    q = wrap_into_limits(arm, found.output_rad, near_rad)
    beyond = limit_excess(arm, q)
    over, joint = beyond.max(axis=0), beyond.argmax(axis=0)
    is_root = np.isfinite(over)
    outside = is_root & (over > 0)
    slots = is_root.shape[0]
    rootless = pad_slots(reasons.verdict, slots, int(BranchVerdict.ABSENT))
    verdict = np.where(
        is_root, np.where(outside, BranchVerdict.OUTSIDE_LIMITS, BranchVerdict.VALID), rootless
    )
    return IkResult(
        q,
        np.where(is_root, found.torque_Nm, 0.0),
        verdict,
        np.where(is_root, joint, pad_slots(reasons.joint, slots, 0)),
        np.where(is_root, np.where(outside, over, 0.0), pad_slots(reasons.excess, slots, 0.0)),
        np.where(is_root | (verdict == BranchVerdict.NOT_CONVERGED), found.error, np.nan),
    )


def pad_result(result: IkResult, slots: int) -> IkResult:
    """Pad the result of targets to a least number of slots.

    Args:
        result: Result of targets, batch (n,).
        slots: Least number of slots.

    Returns:
        The padded result.
    """
    return IkResult(
        output_rad=pad_slots(result.output_rad, slots, np.nan),
        torque_Nm=pad_slots(result.torque_Nm, slots, 0.0),
        verdict=pad_slots(result.verdict, slots, int(BranchVerdict.ABSENT)),
        joint=pad_slots(result.joint, slots, 0),
        excess=pad_slots(result.excess, slots, 0.0),
        error=pad_slots(result.error, slots, np.nan),
    )


def concatenate_results(pieces: list[IkResult]) -> IkResult:
    """Concatenate the results of several batches (n,) in order."""
    slots = max(piece.verdict.shape[0] for piece in pieces)
    return concatenate_records([pad_result(piece, slots) for piece in pieces])


def replace_results(result: IkResult, where: NDArray[np.intp], others: IkResult) -> IkResult:
    """Replace the results of some targets.

    Args:
        result: Result of targets, batch (n,).
        where: Target indices to replace, shape (k,).
        others: New results of these targets, batch (k,).

    Returns:
        A copy of the result with the new values.
    """
    slots = max(result.verdict.shape[0], others.verdict.shape[0])
    return replace_targets(pad_result(result, slots), where, pad_result(others, slots))


def describe_slot(arm: Arm, result: IkResult, slot: int) -> str:
    """Describe one slot of a single target in a sentence."""
    return f"{slot_name(slot)}: {_describe_verdict(arm, result, slot)}"


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
        case BranchVerdict.NOT_CONVERGED:
            return f"no answer found, {result.error[slot]:.2g} left"
        case BranchVerdict.ABSENT:
            return "no further root"


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

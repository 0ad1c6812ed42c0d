"""Inverse kinematics of the arm for a position and an approach: every branch of a target.

The closed form gives the roots of the square rigid arm. Where the arm is not square, or hangs under
gravity, aiming off leads from each of them to the root of the real arm; targets close to a singularity,
where roots meet, part or multiply, are scanned instead. Every root is checked by forward kinematics, and
only limits reject a root.
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


class BranchVerdict(IntEnum):
    """Why a branch is in or out."""

    VALID = 0
    OUTSIDE_LIMITS = 1
    OUT_OF_REACH = 2
    SINGULAR = 3
    """At a singularity of the rigid arm: a family of poses, or on the real arm no pose at all."""
    NOT_CONVERGED = 4
    ABSENT = 5
    """A slot for a further root of a branch that has none."""


@dataclass(frozen=True, slots=True, eq=False)
class IkResult:
    """The branches of each target, batch axes trailing.

    The first eight slots are in the order of BRANCHES; a root has the slot of the square arm's root that it
    belongs to. Very close to singularities a branch of the real arm may have several roots; batches in which
    that happens have eight slots more for the second roots, and so on.
    """

    output_rad: Array
    """(5, slots, ...), in the turn that the limits allow; NaN where there is no root, and where one of an arm
    that hangs or is not square is so far outside the limits that it was not followed."""
    torque_Nm: Array
    """(5, slots, ...), of gravity on each output; 0 for the rigid arm."""
    verdict: Integers
    """(slots, ...), of Verdict."""
    joint: Integers
    """(slots, ...), of Joint: the one farthest beyond its limit (OUTSIDE_LIMITS) or at fault (SINGULAR)."""
    excess: Array
    """(slots, ...): radians over the limit, metres out of reach, or distance from the singularity in metres
    (AZIMUTH) or as a sine; otherwise 0."""
    error: Array
    """(slots, ...): forward check, the largest component of position error [m] and axis error [rad]; NaN
    without angles."""


def pad_result(answers: IkResult, slots: int) -> IkResult:
    """The answers to targets (n,) with at least so many slots."""
    return IkResult(
        output_rad=pad_slots(answers.output_rad, slots, np.nan),
        torque_Nm=pad_slots(answers.torque_Nm, slots, 0.0),
        verdict=pad_slots(answers.verdict, slots, int(BranchVerdict.ABSENT)),
        joint=pad_slots(answers.joint, slots, 0),
        excess=pad_slots(answers.excess, slots, 0.0),
        error=pad_slots(answers.error, slots, np.nan),
    )


def concatenate_results(pieces: list[IkResult]) -> IkResult:
    """The answers to the targets (n,) of all pieces, one after the other."""
    slots = max(piece.verdict.shape[0] for piece in pieces)
    return concatenate_records([pad_result(piece, slots) for piece in pieces])


def replace_results(answers: IkResult, where: NDArray[np.intp], others: IkResult) -> IkResult:
    """The answers to targets (n,), with others (k,) in the place of those `where`."""
    slots = max(answers.verdict.shape[0], others.verdict.shape[0])
    return replace_targets(pad_result(answers, slots), where, pad_result(others, slots))


def select_result(answers: IkResult, index: int) -> IkResult:
    """The answers to one target of a batch (n,)."""
    return select_targets(answers, index)


def describe_slot(arm: Arm, answers: IkResult, slot: int) -> str:
    """The sentence about one slot of a single target."""
    return f"{slot_name(slot)}: {_describe_verdict(arm, answers, slot)}"


def _describe_verdict(arm: Arm, answers: IkResult, slot: int) -> str:
    verdict, excess = BranchVerdict(int(answers.verdict[slot])), float(answers.excess[slot])
    match verdict:
        case BranchVerdict.VALID:
            return "valid"
        case BranchVerdict.OUTSIDE_LIMITS:
            joint = Joint(int(answers.joint[slot]))
            angle = float(answers.output_rad[joint, slot])
            return (
                describe_estimated_outside(arm, joint, excess)
                if np.isnan(angle)
                else describe_outside(arm, joint, angle)
            )
        case BranchVerdict.OUT_OF_REACH:
            return f"out of reach by {format_digits(excess, 3)} m"
        case BranchVerdict.SINGULAR:
            return _describe_singularity(Joint(int(answers.joint[slot])), excess)
        case BranchVerdict.NOT_CONVERGED:
            return f"no answer found, {answers.error[slot]:.2g} left"
        case BranchVerdict.ABSENT:
            return "no further root"


def _describe_singularity(joint: Joint, distance: float) -> str:
    angle_deg = np.degrees(np.arcsin(min(distance, 1.0)))
    match joint:
        case Joint.AZIMUTH:
            what, near = "the turret axis is abreast of the azimuth axis", f"{distance:.3f} m"
        case Joint.ELBOW:
            what, near = "the elbow is straight or folded", f"{angle_deg:.2f} deg"
        case _ if distance < FREE_SINE:
            return "singular, the approach is parallel to the pitch axes and the wrist pitch is free"
        case _:
            what, near = "the approach is parallel to the pitch axes", f"{angle_deg:.2f} deg"
    return f"singular, no pose: {what}, to within {near}"


NEGLIGIBLE_M: Final = 1e-6
ROUNDED_M: Final = 1e-10
"""A target out of reach by less than the one, and the other over the wrist's sine, is at the edge of reach,
within rounding: the smaller the sine, the more the wrist turns."""
SINGULAR_JOINTS: Final = np.array([Joint.AZIMUTH, Joint.ELBOW, Joint.WRIST])
"""The joints at fault at the folds of signs_of."""
CHUNK: Final = 4096
EXACT_CHUNK: Final = 256
SEARCH_CHUNK: Final = 1024
"""Targets at a time, to bound the memory: aimed at, solved exactly (in the cache), scanned for."""


@dataclass(frozen=True, slots=True, eq=False)
class _Reasons:
    """Why a slot has no root, if it has none: Verdict, Joint and excess as in Answers, (slots, n) each."""

    verdict: Integers
    joint: Integers
    excess: Array


def inverse_kinematics(
    arm: Arm,
    tool: int,
    p_RoTo_R_m: Array,
    approach_R: Array,
    gravity_R_m_s2: Array | None = None,
    near_rad: Array | None = None,
) -> IkResult:
    """All branches for positions (3, ...) and unit approach vectors (3, ...), in the rover frame RMECH.

    With gravity (3,) the deflected tool meets the target, without it the rigid one. Where limits allow two
    turns of a joint, the one nearest to `near_rad` (5,) is taken, or to the middle of the range.

    The same targets give the same bits. In another batch they may differ: by 1e-12 rad, and next to double
    roots by what the forward check allows.
    """
    targets = p_RoTo_R_m.shape[1:]
    if np.prod(targets) > EXACT_CHUNK:
        _keep_freed_memory()
    p, a = p_RoTo_R_m.reshape(3, -1), approach_R.reshape(3, -1)
    gravity = np.zeros(3) if gravity_R_m_s2 is None else gravity_R_m_s2
    if arm.orthogonal[tool].is_exact and not gravity.any():
        answers = _solve_exact(arm, tool, p, a, near_rad)
    else:
        answers = _solve_real(arm, tool, p, a, gravity, near_rad)
    return IkResult(*(v.reshape(*v.shape[:-1], *targets) for v in record_arrays(answers)))


def _keep_freed_memory() -> None:
    """Free one large array; after that the C library keeps freed memory, and batches run up to twice as fast.

    It would otherwise hand the memory of every intermediate result back to the system and fetch it again.
    The array is not touched, so it costs nothing.
    """
    np.empty(31 * 2**20, np.uint8)


def _chunks(n: int, size: int) -> Iterator[slice]:
    """Of n targets so many at a time; one chunk at least."""
    return (slice(k, k + size) for k in range(0, max(n, 1), size))


def _solve_exact(arm: Arm, tool: int, p: Array, a: Array, near_rad: Array | None) -> IkResult:
    """The square rigid arm, targets (3, n)."""
    return concatenate_results(
        [_solve_exact_chunk(arm, tool, p[:, k], a[:, k], near_rad) for k in _chunks(p.shape[1], EXACT_CHUNK)]
    )


def _solve_exact_chunk(arm: Arm, tool: int, p: Array, a: Array, near_rad: Array | None) -> IkResult:
    roots = closed_form(arm, tool, p, a)
    X_RT = tool_pose(arm, forward(arm, roots.output_rad), tool)
    error = np.max(np.abs(task_error(X_RT, p[:, None], a[:, None])), axis=0)
    found = (error < ROOT_TOLERANCE) & (roots.wrist_sine >= FREE_SINE)
    output = np.where(found, roots.output_rad, np.nan)
    return _classify(arm, FoundRoots(output, np.zeros_like(output), error), _find_reasons(roots), near_rad)


def _solve_real(arm: Arm, tool: int, p: Array, a: Array, gravity: Array, near_rad: Array | None) -> IkResult:
    """The arm as it is, rigid or hanging, targets (3, n)."""
    chunks = [_solve_real_chunk(arm, tool, p[:, k], a[:, k], gravity) for k in _chunks(p.shape[1], CHUNK)]
    found, reasons, candidates = (concatenate_records(parts) for parts in zip(*chunks, strict=True))
    answers = _classify(arm, found, reasons, near_rad)
    close = np.flatnonzero(candidates.is_candidate.any(axis=0))
    for at in np.split(close, range(SEARCH_CHUNK, close.size, SEARCH_CHUNK)) if close.size else ():
        some = select_targets(candidates, at)
        near = find_near_singular_roots(
            arm, tool, p[:, at], a[:, at], gravity, some, select_targets(found, at)
        )
        answers = replace_results(
            answers, at, _classify(arm, near, _mark_rootless(some, select_targets(reasons, at)), near_rad)
        )
    return answers


def _solve_real_chunk(
    arm: Arm, tool: int, p: Array, a: Array, gravity: Array
) -> tuple[FoundRoots, _Reasons, SingularityCandidates]:
    """The roots that aiming off leads to, why others are out, and where to look more closely."""
    roots = closed_form(arm, tool, p, a)
    each = roots.missing_m.shape
    start, missing = roots.output_rad.reshape(5, -1), roots.missing_m.reshape(-1)
    p8, a8 = (np.broadcast_to(v[:, None], (3, *each)).reshape(3, -1) for v in (p, a))
    over = limit_excess(arm, wrap_into_limits(arm, start)).max(axis=0)
    clear = roots.from_fold.reshape(3, -1).min(axis=0)
    fixed_point = solve_fixed_point(
        arm, tool, p8, a8, gravity, start, clear, (missing == 0) & (over < NEAR_LIMITS_RAD)
    )
    output = np.where(fixed_point.error < root_tolerance(gravity), fixed_point.output_rad, np.nan)
    found = FoundRoots(
        output.reshape(5, *each), fixed_point.torque_Nm.reshape(5, *each), fixed_point.error.reshape(each)
    )
    reasons = _mark_outside(arm, fixed_point, missing == 0, _find_reasons(roots))
    return found, reasons, find_singularity_candidates(arm, tool, p8, a8, roots, fixed_point, over, gravity)


def _find_reasons(roots: Roots) -> _Reasons:
    """Of the square arm."""
    free = roots.wrist_sine < FREE_SINE
    out = roots.missing_m > NEGLIGIBLE_M + np.where(
        free, 0.0, ROUNDED_M / np.maximum(roots.wrist_sine, FREE_SINE)
    )
    singular = free | (roots.missing_m > ROOT_TOLERANCE)  # within rounding, where two roots meet
    verdict = np.full(out.shape, int(BranchVerdict.NOT_CONVERGED))
    verdict[singular], verdict[out] = BranchVerdict.SINGULAR, BranchVerdict.OUT_OF_REACH
    nearest = np.where(free, int(Joint.WRIST), SINGULAR_JOINTS[np.argmin(roots.from_fold, axis=0)])
    at_singularity = np.where(singular, np.where(free, roots.wrist_sine, roots.from_fold.min(axis=0)), 0.0)
    return _Reasons(verdict, nearest, np.where(out, roots.missing_m, at_singularity))


def _mark_outside(arm: Arm, fixed_point: FixedPointRoots, reached: Flags, reasons: _Reasons) -> _Reasons:
    """Roots of the square arm that were not followed to the end are outside the limits, by about so much."""
    beyond = limit_excess(arm, wrap_into_limits(arm, fixed_point.output_rad))
    outside = (reached & ~fixed_point.followed).reshape(reasons.verdict.shape)
    over, joint = (v.reshape(outside.shape) for v in (beyond.max(axis=0), beyond.argmax(axis=0)))
    return _Reasons(
        np.where(outside, BranchVerdict.OUTSIDE_LIMITS, reasons.verdict),
        np.where(outside, joint, reasons.joint),
        np.where(outside, over, reasons.excess),
    )


def _mark_rootless(candidates: SingularityCandidates, reasons: _Reasons) -> _Reasons:
    """If a candidate has no root after the scan, it has gone where it would have met another."""
    distance = candidates.from_fold
    nearest = SINGULAR_JOINTS[np.argmin(distance, axis=0)]
    rootless = (reasons.verdict == BranchVerdict.NOT_CONVERGED) | (reasons.verdict == BranchVerdict.SINGULAR)
    gone = candidates.is_candidate & rootless
    return _Reasons(
        np.where(gone, BranchVerdict.SINGULAR, reasons.verdict),
        np.where(gone, nearest, reasons.joint),
        np.where(gone, np.maximum(distance.min(axis=0), FREE_SINE), reasons.excess),
    )


def _classify(arm: Arm, found: FoundRoots, reasons: _Reasons, near_rad: Array | None) -> IkResult:
    """Verdicts on roots, and reasons where there are none."""
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

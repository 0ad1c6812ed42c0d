"""Inverse kinematics of the arm for a position and an approach: every branch of a target.

The closed form gives the roots of the square rigid arm. Where the arm is not square, or hangs under
gravity, aiming off leads from each of them to the root of the real arm; targets close to a singularity,
where roots meet, part or multiply, are scanned instead. Every root is checked by forward kinematics, and
only limits reject a root.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.dictionary.joints import Joint
from fsw.kinematics.aim import Aimed, aim_off, tolerance
from fsw.kinematics.answers import Answers, Verdict, join, put
from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import FREE_SINE, Roots, closed_form
from fsw.kinematics.limits import beyond_limits, into_limits
from fsw.kinematics.records import at_targets, concatenated, extended, values_of
from fsw.kinematics.singular import FoundRoots, roots_near_singularity
from fsw.kinematics.suspects import NEAR_LIMITS_RAD, Suspects, find_suspects
from fsw.kinematics.task import ROOT_TOLERANCE, task_error
from fsw.kinematics.transforms import Array, Flags, Numbers

NEGLIGIBLE_M: Final = 1e-6
ROUNDED_M: Final = 1e-10
"""A target out of reach by less than the one, and the other over the wrist's sine, is at the edge of reach,
within rounding: the smaller the sine, the more the wrist turns."""
SINGULAR_JOINTS: Final = np.array([Joint.AZIMUTH, Joint.ELBOW, Joint.WRIST])
"""The joints at fault at the folds of signs_of."""
CHUNK: Final = 4096
EXACT_CHUNK: Final = 256
SCAN_CHUNK: Final = 1024
"""Targets at a time, to bound the memory: aimed at, solved exactly (in the cache), scanned for."""


@dataclass(frozen=True, slots=True, eq=False)
class _Reasons:
    """Why a slot has no root, if it has none: Verdict, Joint and excess as in Answers, (slots, n) each."""

    verdict: Numbers
    joint: Numbers
    excess: Array


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

    The same targets give the same bits. In another batch they may differ: by 1e-12 rad, and next to double
    roots by what the forward check allows.
    """
    targets = p_RoTo_R_m.shape[1:]
    if np.prod(targets) > EXACT_CHUNK:
        _keep_freed_memory()
    p, a = p_RoTo_R_m.reshape(3, -1), approach_R.reshape(3, -1)
    gravity = np.zeros(3) if gravity_R_m_s2 is None else gravity_R_m_s2
    if arm.shapes[tool].is_exact and not gravity.any():
        answers = _exact(arm, tool, p, a, near_rad)
    else:
        answers = _real(arm, tool, p, a, gravity, near_rad)
    return Answers(*(v.reshape(*v.shape[:-1], *targets) for v in values_of(answers)))


def _keep_freed_memory() -> None:
    """Free one large array; after that the C library keeps freed memory, and batches run up to twice as fast.

    It would otherwise hand the memory of every intermediate result back to the system and fetch it again.
    The array is not touched, so it costs nothing.
    """
    np.empty(31 * 2**20, np.uint8)


def _chunks(n: int, size: int) -> Iterator[slice]:
    """Of n targets so many at a time; one chunk at least."""
    return (slice(k, k + size) for k in range(0, max(n, 1), size))


def _exact(arm: Arm, tool: int, p: Array, a: Array, near_rad: Array | None) -> Answers:
    """The square rigid arm, targets (3, n)."""
    return join(
        [_exact_chunk(arm, tool, p[:, k], a[:, k], near_rad) for k in _chunks(p.shape[1], EXACT_CHUNK)]
    )


def _exact_chunk(arm: Arm, tool: int, p: Array, a: Array, near_rad: Array | None) -> Answers:
    roots = closed_form(arm, tool, p, a)
    X_RT = tool_pose(arm, forward(arm, roots.output_rad), tool)
    error = np.max(np.abs(task_error(X_RT, p[:, None], a[:, None])), axis=0)
    found = (error < ROOT_TOLERANCE) & (roots.wrist_sine >= FREE_SINE)
    output = np.where(found, roots.output_rad, np.nan)
    return _judged(arm, FoundRoots(output, np.zeros_like(output), error), _why_not(roots), near_rad)


def _real(arm: Arm, tool: int, p: Array, a: Array, gravity: Array, near_rad: Array | None) -> Answers:
    """The arm as it is, rigid or hanging, targets (3, n)."""
    chunks = [_aimed_chunk(arm, tool, p[:, k], a[:, k], gravity) for k in _chunks(p.shape[1], CHUNK)]
    found, reasons, suspects = (concatenated(parts) for parts in zip(*chunks, strict=True))
    answers = _judged(arm, found, reasons, near_rad)
    close = np.flatnonzero(suspects.is_suspect.any(axis=0))
    for at in np.split(close, range(SCAN_CHUNK, close.size, SCAN_CHUNK)) if close.size else ():
        some = at_targets(suspects, at)
        near = roots_near_singularity(arm, tool, p[:, at], a[:, at], gravity, some, at_targets(found, at))
        answers = put(answers, at, _judged(arm, near, _without_pose(some, at_targets(reasons, at)), near_rad))
    return answers


def _aimed_chunk(
    arm: Arm, tool: int, p: Array, a: Array, gravity: Array
) -> tuple[FoundRoots, _Reasons, Suspects]:
    """The roots that aiming off leads to, why others are out, and where to look more closely."""
    roots = closed_form(arm, tool, p, a)
    each = roots.missing_m.shape
    start, missing = roots.output_rad.reshape(5, -1), roots.missing_m.reshape(-1)
    p8, a8 = (np.broadcast_to(v[:, None], (3, *each)).reshape(3, -1) for v in (p, a))
    over = beyond_limits(arm, into_limits(arm, start)).max(axis=0)
    clear = roots.from_fold.reshape(3, -1).min(axis=0)
    aimed = aim_off(arm, tool, p8, a8, gravity, start, clear, (missing == 0) & (over < NEAR_LIMITS_RAD))
    output = np.where(aimed.error < tolerance(gravity), aimed.output_rad, np.nan)
    found = FoundRoots(output.reshape(5, *each), aimed.torque_Nm.reshape(5, *each), aimed.error.reshape(each))
    reasons = _outside_by_estimate(arm, aimed, missing == 0, _why_not(roots))
    return found, reasons, find_suspects(arm, tool, p8, a8, roots, aimed, over, gravity)


def _why_not(roots: Roots) -> _Reasons:
    """Of the square arm."""
    free = roots.wrist_sine < FREE_SINE
    out = roots.missing_m > NEGLIGIBLE_M + np.where(
        free, 0.0, ROUNDED_M / np.maximum(roots.wrist_sine, FREE_SINE)
    )
    singular = free | (roots.missing_m > ROOT_TOLERANCE)  # within rounding, where two roots meet
    verdict = np.full(out.shape, int(Verdict.NOT_CONVERGED))
    verdict[singular], verdict[out] = Verdict.SINGULAR, Verdict.OUT_OF_REACH
    nearest = np.where(free, int(Joint.WRIST), SINGULAR_JOINTS[np.argmin(roots.from_fold, axis=0)])
    at_singularity = np.where(singular, np.where(free, roots.wrist_sine, roots.from_fold.min(axis=0)), 0.0)
    return _Reasons(verdict, nearest, np.where(out, roots.missing_m, at_singularity))


def _outside_by_estimate(arm: Arm, aimed: Aimed, reached: Flags, reasons: _Reasons) -> _Reasons:
    """Roots of the square arm that were not followed to the end are outside the limits, by about so much."""
    beyond = beyond_limits(arm, into_limits(arm, aimed.output_rad))
    outside = (reached & ~aimed.followed).reshape(reasons.verdict.shape)
    over, joint = (v.reshape(outside.shape) for v in (beyond.max(axis=0), beyond.argmax(axis=0)))
    return _Reasons(
        np.where(outside, Verdict.OUTSIDE_LIMITS, reasons.verdict),
        np.where(outside, joint, reasons.joint),
        np.where(outside, over, reasons.excess),
    )


def _without_pose(suspects: Suspects, reasons: _Reasons) -> _Reasons:
    """If a suspect has no root after the scan, it has gone where it would have met another."""
    distance = suspects.from_fold
    nearest = SINGULAR_JOINTS[np.argmin(distance, axis=0)]
    rootless = (reasons.verdict == Verdict.NOT_CONVERGED) | (reasons.verdict == Verdict.SINGULAR)
    gone = suspects.is_suspect & rootless
    return _Reasons(
        np.where(gone, Verdict.SINGULAR, reasons.verdict),
        np.where(gone, nearest, reasons.joint),
        np.where(gone, np.maximum(distance.min(axis=0), FREE_SINE), reasons.excess),
    )


def _judged(arm: Arm, found: FoundRoots, reasons: _Reasons, near_rad: Array | None) -> Answers:
    """Verdicts on roots, and reasons where there are none."""
    q = into_limits(arm, found.output_rad, near_rad)
    beyond = beyond_limits(arm, q)
    over, joint = beyond.max(axis=0), beyond.argmax(axis=0)
    is_root = np.isfinite(over)
    outside = is_root & (over > 0)
    slots = is_root.shape[0]
    rootless = extended(reasons.verdict, slots, int(Verdict.ABSENT))
    verdict = np.where(is_root, np.where(outside, Verdict.OUTSIDE_LIMITS, Verdict.VALID), rootless)
    return Answers(
        q,
        np.where(is_root, found.torque_Nm, 0.0),
        verdict,
        np.where(is_root, joint, extended(reasons.joint, slots, 0)),
        np.where(is_root, np.where(outside, over, 0.0), extended(reasons.excess, slots, 0.0)),
        np.where(is_root | (verdict == Verdict.NOT_CONVERGED), found.error, np.nan),
    )

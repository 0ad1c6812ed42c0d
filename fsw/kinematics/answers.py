"""What the inverse kinematics answers: for every branch its angles, or the reason that it is out."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.joints import Joint
from fsw.kinematics.arm import Arm
from fsw.kinematics.branches import slot_name
from fsw.kinematics.closed_form import FREE_SINE
from fsw.kinematics.limits import about_outside, digits, outside
from fsw.kinematics.records import at_targets, concatenated, extended, replaced
from fsw.kinematics.transforms import Array, Numbers


class Verdict(IntEnum):
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
class Answers:
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
    verdict: Numbers
    """(slots, ...), of Verdict."""
    joint: Numbers
    """(slots, ...), of Joint: the one farthest beyond its limit (OUTSIDE_LIMITS) or at fault (SINGULAR)."""
    excess: Array
    """(slots, ...): radians over the limit, metres out of reach, or distance from the singularity in metres
    (AZIMUTH) or as a sine; otherwise 0."""
    error: Array
    """(slots, ...): forward check, the largest component of position error [m] and axis error [rad]; NaN
    without angles."""


def with_slots(answers: Answers, slots: int) -> Answers:
    """The answers to targets (n,) with at least so many slots."""
    return Answers(
        output_rad=extended(answers.output_rad, slots, np.nan),
        torque_Nm=extended(answers.torque_Nm, slots, 0.0),
        verdict=extended(answers.verdict, slots, int(Verdict.ABSENT)),
        joint=extended(answers.joint, slots, 0),
        excess=extended(answers.excess, slots, 0.0),
        error=extended(answers.error, slots, np.nan),
    )


def join(pieces: list[Answers]) -> Answers:
    """The answers to the targets (n,) of all pieces, one after the other."""
    slots = max(piece.verdict.shape[0] for piece in pieces)
    return concatenated([with_slots(piece, slots) for piece in pieces])


def put(answers: Answers, where: NDArray[np.intp], others: Answers) -> Answers:
    """The answers to targets (n,), with others (k,) in the place of those `where`."""
    slots = max(answers.verdict.shape[0], others.verdict.shape[0])
    return replaced(with_slots(answers, slots), where, with_slots(others, slots))


def at_target(answers: Answers, index: int) -> Answers:
    """The answers to one target of a batch (n,)."""
    return at_targets(answers, index)


def why(arm: Arm, answers: Answers, slot: int) -> str:
    """The sentence about one slot of a single target."""
    return f"{slot_name(slot)}: {_reason(arm, answers, slot)}"


def _reason(arm: Arm, answers: Answers, slot: int) -> str:
    verdict, excess = Verdict(int(answers.verdict[slot])), float(answers.excess[slot])
    match verdict:
        case Verdict.VALID:
            return "valid"
        case Verdict.OUTSIDE_LIMITS:
            joint = Joint(int(answers.joint[slot]))
            angle = float(answers.output_rad[joint, slot])
            return about_outside(arm, joint, excess) if np.isnan(angle) else outside(arm, joint, angle)
        case Verdict.OUT_OF_REACH:
            return f"out of reach by {digits(excess, 3)} m"
        case Verdict.SINGULAR:
            return _singular(Joint(int(answers.joint[slot])), excess)
        case Verdict.NOT_CONVERGED:
            return f"no answer found, {answers.error[slot]:.2g} left"
        case Verdict.ABSENT:
            return "no further root"


def _singular(joint: Joint, distance: float) -> str:
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

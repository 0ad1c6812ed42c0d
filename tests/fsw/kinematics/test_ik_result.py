"""Results as records: a sentence for every verdict, and the selection of targets."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import FREE_SINE, BranchVerdict, IkResult, describe_slot
from tests.fsw.rig import config_of

ARM = config_of().arm


def one(verdict, joint=Joint.AZIMUTH, excess=0.0, error=np.nan, angle=np.nan):
    """Build the result of one target with values in one slot."""
    blank = IkResult(
        np.full((5, 8), np.nan), np.zeros((5, 8)), np.zeros(8, int), np.zeros(8, int),
        np.zeros(8), np.full(8, np.nan),
    )  # fmt: skip
    blank.verdict[2], blank.joint[2], blank.excess[2], blank.error[2] = (verdict, joint, excess, error)
    blank.output_rad[:, 2] = angle
    return blank


LIMITS = "its soft limits -164.2 .. 164.2 deg"
SENTENCES = [
    (one(BranchVerdict.VALID, angle=0.1, error=0.0), "valid"),
    (
        one(BranchVerdict.OUTSIDE_LIMITS, Joint.ELBOW, 0.1, 0.0, 3.0),
        f"joint elbow: 171.9 deg is outside {LIMITS}",
    ),
    (one(BranchVerdict.OUTSIDE_LIMITS, Joint.ELBOW, 0.1), f"joint elbow: about 5.7 deg outside {LIMITS}"),
    (one(BranchVerdict.OUT_OF_REACH, excess=0.0123), "out of reach by 0.012 m"),
    (
        one(BranchVerdict.SINGULAR, Joint.AZIMUTH, 0.0123),
        "singular, no pose: the turret axis is abreast of the azimuth axis, to within 0.012 m",
    ),
    (
        one(BranchVerdict.SINGULAR, Joint.ELBOW, 0.0123),
        "singular, no pose: the elbow is straight or folded, to within 0.70 deg",
    ),
    (
        one(BranchVerdict.SINGULAR, Joint.WRIST, 0.0123),
        "singular, no pose: the approach is parallel to the pitch axes, to within 0.70 deg",
    ),
    (
        one(BranchVerdict.SINGULAR, Joint.WRIST, 0.5 * FREE_SINE),
        "singular, the approach is parallel to the pitch axes and the wrist pitch is free",
    ),
]


@pytest.mark.parametrize(("result", "reason"), SENTENCES)
def test_every_verdict_has_its_sentence(result, reason):
    assert describe_slot(ARM, result, 2) == f"{BRANCHES[2]}: {reason}"


def test_no_verdict_is_without_a_sentence():
    assert {int(result.verdict[2]) for result, _ in SENTENCES} == set(BranchVerdict)

"""Results as records: a sentence for every verdict, more slots, concatenated and replaced batches."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.batch import pad_slots, select_targets
from fsw.kinematics.branches import BRANCHES
from fsw.kinematics.ik import (
    FREE_SINE,
    BranchVerdict,
    IkResult,
    concatenate_results,
    describe_slot,
    pad_result,
    replace_results,
)
from tests.fsw.kinematics.lab import assert_consistent, near_double_roots
from tests.fsw.rig import config_of

ARM = config_of().arm


def result_of(n, slots=8, seed=0):
    """Build a result of distinct numbers, batch (n,)."""
    rng = np.random.default_rng(seed)
    whole = (slots, n)
    return IkResult(
        rng.normal(size=(5, *whole)), rng.normal(size=(5, *whole)), rng.integers(0, 5, whole),
        rng.integers(0, 5, whole), rng.random(whole), rng.random(whole),
    )  # fmt: skip


def one(verdict, joint=Joint.AZIMUTH, excess=0.0, error=np.nan, angle=np.nan, slot=2, slots=8):
    """Build the result of one target with values in one slot."""
    blank = IkResult(
        np.full((5, slots), np.nan), np.zeros((5, slots)), np.zeros(slots, int), np.zeros(slots, int),
        np.zeros(slots), np.full(slots, np.nan),
    )  # fmt: skip
    blank.verdict[slot], blank.joint[slot], blank.excess[slot], blank.error[slot] = (
        verdict,
        joint,
        excess,
        error,
    )
    blank.output_rad[:, slot] = angle
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
    (one(BranchVerdict.NOT_CONVERGED, error=3.2e-4), "no answer found, 0.00032 left"),
    (one(BranchVerdict.ABSENT), "no further root"),
]


@pytest.mark.parametrize(("result", "reason"), SENTENCES)
def test_every_verdict_has_its_sentence(result, reason):
    assert describe_slot(ARM, result, 2) == f"{BRANCHES[2]}: {reason}"


def test_no_verdict_is_without_a_sentence():
    assert {int(result.verdict[2]) for result, _ in SENTENCES} == set(BranchVerdict)


def test_a_slot_for_a_further_root_is_called_by_its_branch_and_number():
    assert (
        describe_slot(ARM, one(BranchVerdict.ABSENT, slot=21, slots=24), 21)
        == f"{BRANCHES[5]}, root 3: no further root"
    )


def test_more_slots_leave_what_is_there_and_say_that_the_new_ones_are_empty():
    result = result_of(5)
    wide = pad_result(result, 24)
    for name in IkResult.__slots__:
        np.testing.assert_array_equal(getattr(wide, name)[..., :8, :], getattr(result, name))
    assert (wide.verdict[8:] == BranchVerdict.ABSENT).all()
    assert np.isnan(wide.output_rad[:, 8:]).all()
    assert np.isnan(wide.error[8:]).all()
    for empty in (wide.torque_Nm[:, 8:], wide.joint[8:], wide.excess[8:]):
        assert not empty.any()
    assert wide.verdict.dtype == result.verdict.dtype


def test_slots_are_never_taken_away():
    assert pad_result(result_of(5, slots=16), 8).verdict.shape == (16, 5)
    values = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(pad_slots(values, 2, 7.0), values)
    np.testing.assert_array_equal(pad_slots(values, 3, 7.0), [[0, 1, 2], [3, 4, 5], [7, 7, 7]])


def test_pieces_are_joined_in_their_order_with_the_slots_of_the_widest():
    pieces = [result_of(3, 8, 1), result_of(0, 8, 2), result_of(4, 24, 3), result_of(2, 16, 4)]
    whole, at = concatenate_results(pieces), 0
    assert whole.verdict.shape == (24, 9)
    for piece in pieces:
        n = piece.verdict.shape[1]
        for name in IkResult.__slots__:
            part = getattr(whole, name)[..., at : at + n]
            np.testing.assert_array_equal(part, getattr(pad_result(piece, 24), name))
        at += n


@pytest.mark.parametrize(("slots", "others"), [(8, 8), (8, 24), (16, 8)])
def test_results_put_in_the_place_of_others_leave_the_rest(slots, others):
    result, new, where = result_of(6, slots, 1), result_of(2, others, 2), np.array([4, 1])
    both, widest = replace_results(result, where, new), max(slots, others)
    rest = np.array([0, 2, 3, 5])
    for name in IkResult.__slots__:
        value = getattr(both, name)
        np.testing.assert_array_equal(value[..., where], getattr(pad_result(new, widest), name))
        np.testing.assert_array_equal(value[..., rest], getattr(pad_result(result, widest), name)[..., rest])
    for name in IkResult.__slots__:
        np.testing.assert_array_equal(getattr(result, name), getattr(result_of(6, slots, 1), name))


def test_one_target_is_selected_from_a_batch():
    result = result_of(5, 16)
    for k in range(5):
        single = select_targets(result, k)
        for name in IkResult.__slots__:
            np.testing.assert_array_equal(getattr(single, name), getattr(result, name)[..., k])


def test_a_target_taken_out_of_a_wide_batch_stays_consistent():
    solved = near_double_roots("nominal", "mars", "apxs", 40)
    assert solved.result.verdict.shape[0] > 8
    for k in range(40):
        assert_consistent(solved.trial.arm, select_targets(solved.result, k))

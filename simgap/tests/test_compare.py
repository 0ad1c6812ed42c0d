"""Comparison of two sets of logs: what both share is no change, and what differs is named with its sign."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from helpers.marks import slow_but
from helpers.toy import BASE, CATALOGUE, NAMES, Toy, ToyResiduals, draw_toy
from helpers.verdicts import LIFT, diagnosis, finding
from simgap.assemble import select_sure
from simgap.compare import list_differences, list_limits, select_differences, tell_apart
from simgap.effects.effect import Size
from simgap.effects.variation import Difference
from simgap.report.document import comparison_details, comparison_lines
from simgap.result import Comparison, Limit
from simgap.selection.checkpoint import Meter
from simgap.selection.context import Score
from simgap.selection.selection import SHORTLIST, list_best

N_MOTIONS = 8


def draw_sets(seed, common, change):
    """Draw two sets of motions; the effects of the second differ by a change."""
    after = {key: common.get(key, 0.0) + change.get(key, 0.0) for key in {*common, *change}}
    sets = [draw_toy(seed, common, N_MOTIONS), draw_toy(seed + 100, after, N_MOTIONS)]
    arrays = ([getattr(one, of) for one in sets] for of in ("commands", "measured"))
    commands, measured = (np.concatenate(one, axis=1) for one in arrays)
    model = ToyResiduals(commands, measured, NAMES)
    repeats = (*("",) * (N_MOTIONS - 2), "r", "r")
    model.motions = tuple(f"{part}:{k}" for part in ("before", "after") for k in range(N_MOTIONS))
    model.repeat_of = tuple(one and f"{part}:{one}" for part in ("before", "after") for one in repeats)
    return model


def compare_toys(model):
    shown = (*CATALOGUE, *BASE)  # a catalogue may have what is in the base too
    found = select_differences(tell_apart(model), BASE, shown, 1, Meter())
    return select_sure(found, None)[0]


@pytest.mark.parametrize("seed", slow_but(range(1, 6), 1))
@pytest.mark.parametrize(
    "change", [{}, {"far: sine": 0.05}, {"near: square": -0.1}], ids=["none", "new", "gone"]
)
def test_a_change_is_named_with_its_size_and_what_is_common_is_not(seed, change):
    found = compare_toys(draw_sets(seed, {"near: square": 0.1}, change))
    columns = found.context.union.columns
    sizes = {one.key: float(found.chosen.sizes[columns([one])][0]) for one in list_differences(found)}
    assert sizes.keys() == {key.replace(": ", ": change of ") for key in change}
    assert [*sizes.values()] == pytest.approx([*change.values()], rel=0.1)


def test_a_change_that_was_not_seen_has_a_limit():
    limits = list_limits(compare_toys(draw_sets(1, {}, {})))
    assert [(one.place, one.name) for one in limits] == [("near", "gain"), ("far", "gain")]
    assert all(one.low <= 0.0 <= one.high and one.high - one.low < 0.01 for one in limits)


@dataclass(frozen=True)
class Amount(Toy):
    """Toy whose size is not negative."""

    @property
    def sizes(self):
        return (Size(self.label, 0.0, 5.0, 1.0),)


def test_an_amount_that_grows_acts_after_and_one_that_falls_before():
    raw = draw_sets(1, {}, {})
    amount, is_after = Amount("near", "square", np.square), raw.motion_of >= N_MOTIONS
    change = Difference("near", amount)
    (none,), (all_of_it,) = (raw.residuals([amount], np.array([[size]])) for size in (0.0, 2.0))
    for size, acts in ((2.0, is_after), (-2.0, ~is_after)):
        model = tell_apart(raw)
        order = np.lexsort((raw.time_s, raw.joint_of, raw.motion_of))
        (moved,) = model.residuals([change], np.array([[size]]))
        expected = np.where(acts, all_of_it, none)[order]
        place = np.lexsort((model.time_s, model.joint_of, model.motion_of))
        assert np.array_equal(moved[place], expected)
    assert (change.name, change.describe(np.array([-2.0]))) == ("change of square", "square -2")


def test_an_effect_and_its_change_count_once_in_the_shortlist_and_are_both_refitted():
    effects = [*CATALOGUE[: SHORTLIST + 1], Difference("near", CATALOGUE[0])]
    ranked = [Score(one, np.zeros(0), 0.1) for one in effects]
    assert [one.effect for one in list_best(ranked)] == [*effects[:SHORTLIST], effects[-1]]


def test_four_lines_tell_a_change_or_what_could_not_be_seen():
    limit = Limit("lift", "gain_ratio", -0.02, 0.03)
    found = diagnosis(findings=(finding(effect="change of gain", text="gain_ratio -0.1"),))
    where, what, far, following = comparison_lines(Comparison(found, (limit,)))
    assert where == "Where: lift."
    assert what.startswith("What: change of gain at lift (gain_ratio -0.1), 95 % sure")
    assert far == (
        "How far: with one model for both, the error of lift is 12 mrad; with the changes 2.4 mrad "
        "(noise: 2 mrad)."
    )
    nothing = Comparison(replace(found, findings=(), errors=(LIFT,)), (limit,))
    where, what, _, following = comparison_lines(nothing)
    assert where == "Where: nowhere; one model fits both sets of logs."
    assert what == "What: nothing changed that these logs show."
    assert following == "Not seen: smaller changes; the limits of each joint follow."
    limits = "Changes may lie within gain_ratio of lift from -0.02 to +0.03 (90 %)."
    assert comparison_details(nothing)[-1] == limits
    beside = f"Beside what was found, c{limits[1:]}"
    assert comparison_details(Comparison(found, (limit,)))[-1] == beside
    assert comparison_lines(replace(nothing, limits=()))[3] == "No base parameter can be told."

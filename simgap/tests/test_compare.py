"""Comparison of two sets of logs: what both share is no change, and what differs is named with its sign."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.marks import slow_but
from helpers.toy import BASE, CATALOGUE, NAMES, ToyResiduals, draw_toy
from helpers.verdicts import LIFT, diagnosis, finding
from simgap.assemble import select_sure
from simgap.compare import AFTER, list_limits
from simgap.report.comparison import comparison_lines
from simgap.residuals.known_effects import Change, KnownResiduals
from simgap.result import Comparison, Limit
from simgap.selection.context import Selection
from simgap.selection.selection import select_effects

N_MOTIONS = 8


def draw_sets(seed: int, common: dict[str, float], change: dict[str, float]) -> ToyResiduals:
    """Draw two sets of motions; the effects of the second differ by a change."""
    after = {key: common.get(key, 0.0) + change.get(key, 0.0) for key in {*common, *change}}
    sets = [draw_toy(seed, common, N_MOTIONS), draw_toy(seed + 100, after, N_MOTIONS)]
    commands, measured = (
        np.concatenate([getattr(one, of) for one in sets], axis=1) for of in ("commands", "measured")
    )
    model = ToyResiduals(commands, measured, NAMES)
    repeats = (*("",) * (N_MOTIONS - 2), "r", "r")
    model.motions = tuple(f"{part}:{k}" for part in ("before", "after") for k in range(N_MOTIONS))
    model.repeat_of = tuple(one and f"{part}:{one}" for part in ("before", "after") for one in repeats)
    return model


def compare_toys(model: ToyResiduals) -> Selection:
    common = select_effects(model, BASE, CATALOGUE, seed=1)
    present, columns = (*BASE, *common.chosen.effects), common.context.union.columns
    known = {one: common.chosen.sizes[columns([one])] for one in present}
    changes = [Change(one.place, one) for one in (*BASE, *CATALOGUE)]
    is_after = np.array([name.startswith(AFTER) for name in model.motions])
    return select_sure(
        select_effects(KnownResiduals(model, known, is_after), present, changes, seed=1), None
    )[0]


@pytest.mark.parametrize("seed", slow_but(range(1, 6), 1))
@pytest.mark.parametrize(
    "change", [{}, {"far: sine": 0.05}, {"near: square": -0.1}], ids=["none", "new", "gone"]
)
def test_a_change_is_named_with_its_size_and_what_is_common_is_not(
    seed: int, change: dict[str, float]
) -> None:
    found = compare_toys(draw_sets(seed, {"near: square": 0.1}, change))
    columns = found.context.union.columns
    sizes = {one.key: float(found.chosen.sizes[columns([one])][0]) for one in found.chosen.effects}
    assert sizes.keys() == {key.replace(": ", ": change of ") for key in change}
    assert [*sizes.values()] == pytest.approx([*change.values()], rel=0.1)


def test_a_change_that_was_not_seen_has_a_limit() -> None:
    found = compare_toys(draw_sets(1, {}, {}))
    limits = list_limits(found, [Change(one.place, one) for one in BASE])
    assert [(one.place, one.name) for one in limits] == [("near", "gain"), ("far", "gain")]
    assert all(one.low <= 0.0 <= one.high and one.high - one.low < 0.01 for one in limits)


def test_a_change_may_undo_an_effect_but_not_turn_it_round() -> None:
    model = draw_sets(1, {}, {})
    square, change = CATALOGUE[0], Change("near", CATALOGUE[0])
    is_after = np.array([name.startswith(AFTER) for name in model.motions])
    known = KnownResiduals(model, {square: np.array([4.0])}, is_after)
    alone, beyond = known.residuals([change], np.array([[1.0], [7.0]]))
    assert np.array_equal(alone, beyond)  # the largest size is 5
    after = is_after[model.motion_of]
    (same,) = known.residuals([], np.zeros((1, 0)))
    assert np.array_equal(alone[~after], same[~after])
    assert not np.array_equal(alone[after], same[after])


def test_four_lines_tell_a_change_or_what_could_not_be_seen() -> None:
    limit = Limit("lift", "gain_ratio", -0.02, 0.03)
    found = diagnosis(findings=(finding(effect="change of gain", text="gain_ratio -0.1"),))
    where, what, far, following = comparison_lines(Comparison(found, (limit,)))
    assert where == "Where: lift."
    assert what.startswith("What: change of gain at lift (gain_ratio -0.1), 95 % sure")
    assert far == (
        "How far: with one model for both, the error of lift is 25.5 mrad; with the changes 2.4 mrad "
        "(noise: 2 mrad)."
    )
    nothing = Comparison(replace(found, findings=(), errors=(LIFT,)), (limit,))
    where, what, _, following = comparison_lines(nothing)
    assert (where, what) == (
        "Where: nowhere; one model fits both sets of logs.",
        "What: nothing changed that these logs show.",
    )
    assert following == "Not seen: changes may lie within gain_ratio of lift from -0.02 to +0.03 (90 %)."

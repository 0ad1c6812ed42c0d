"""Progress of a selection."""

from itertools import pairwise

import pytest

from helpers.marks import slow_but
from helpers.toy import BASE, CATALOGUE, draw_toy
from simgap.selection.checkpoint import Meter
from simgap.selection.selection import select_effects
from simgap.selection.verdict import find_confidence_sets

TRUTHS = ({"near: square": 0.1}, {"near: square": 0.1, "far: sine": 0.05})


@pytest.mark.parametrize("truth", slow_but(TRUTHS, TRUTHS[1]))
def test_the_share_of_a_selection_is_never_far_from_that_of_its_candidates(truth: dict[str, float]) -> None:
    model = draw_toy(1, truth)
    reports: list[tuple[float, int]] = []
    meter = Meter(lambda share, text: reports.append((share, model.calls)))
    find_confidence_sets(select_effects(model, BASE, CATALOGUE, seed=1, meter=meter))
    assert all(before[0] <= after[0] for before, after in pairwise(reports))
    assert max(abs(share - calls / model.calls) for share, calls in reports) < 0.25
    assert reports[-1][0] < 1.0


def test_a_round_that_takes_longer_than_expected_never_seems_done() -> None:
    shares: list[float] = []
    meter = Meter(lambda share, text: shares.append(share))
    meter.begin_round(30, 0)
    for _ in range(100):
        meter.advance("refit", 10)
    assert shares[0] == pytest.approx(1.0 / 3.0)
    assert shares[-1] == pytest.approx(1.0 / 1.1)

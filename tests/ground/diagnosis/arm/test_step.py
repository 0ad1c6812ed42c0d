"""Steps are a few times what can be seen, whatever the first try was."""

import numpy as np
import pytest

from ground.diagnosis.arm.step import LEAST_SHARE, MOST_SHARE, NEAR_ENOUGH, ROUNDS, SEEN, mended, off


@pytest.mark.parametrize("per_typical", np.geomspace(2 * SEEN / MOST_SHARE, SEEN / LEAST_SHARE / 2, 7))
def test_a_step_along_a_line_is_mended_at_once(per_typical: float) -> None:
    better = mended(1.0, per_typical) or 1.0
    assert 1.0 / NEAR_ENOUGH <= better * per_typical / SEEN <= NEAR_ENOUGH
    assert mended(better, better * per_typical) is None


def test_a_step_beyond_a_jump_comes_back_before_it() -> None:
    """Something changes sides at 0.05 of a typical size, and hides what is visible from 0.02 on."""

    def seen(share: float) -> float:
        return 100.0 * share + (400.0 if share > 0.05 else 0.0)

    share = 1.0
    for _ in range(ROUNDS):
        share = mended(share, seen(share)) or share
    assert share < 0.05


def test_a_step_that_shows_nothing_is_worse_than_any_other() -> None:
    assert off(0.0) > off(1e-9) > off(SEEN / 2) > off(SEEN) == 0.0
    assert off(3 * SEEN) == pytest.approx(off(SEEN / 3))


def test_what_is_never_seen_is_left_alone() -> None:
    assert mended(1.0, 0.0) is None
    assert mended(MOST_SHARE, SEEN / 100) is None
    assert mended(LEAST_SHARE, SEEN * 100) is None

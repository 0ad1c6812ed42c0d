"""Adaptive steps reach a few times the detection limit, whatever the first step."""

import numpy as np
import pytest

from marsarm.diagnosis.arm.finite_differences import (
    MAX_ROUNDS,
    MAX_STEP_RATIO,
    MAX_STEP_SHARE,
    MIN_STEP_SHARE,
    TARGET_SIGMAS,
    adapt_step,
    step_error,
)


@pytest.mark.parametrize(
    "per_typical", np.geomspace(2 * TARGET_SIGMAS / MAX_STEP_SHARE, TARGET_SIGMAS / MIN_STEP_SHARE / 2, 7)
)
def test_a_step_along_a_line_is_adapted_at_once(per_typical: float) -> None:
    better = adapt_step(1.0, per_typical) or 1.0
    assert 1.0 / MAX_STEP_RATIO <= better * per_typical / TARGET_SIGMAS <= MAX_STEP_RATIO
    assert adapt_step(better, better * per_typical) is None
    assert step_error(better * per_typical) < step_error(0.0)


def test_a_step_beyond_a_jump_comes_back_before_it() -> None:
    """A backlash changes sides at 0.05 of a typical size, and hides what is visible from 0.02 on."""
    share = 1.0
    for _ in range(MAX_ROUNDS):
        share = adapt_step(share, 100.0 * share + (400.0 if share > 0.05 else 0.0)) or share
    assert share < 0.05

"""Saved sensitivities, adaptive steps to a few times the detection limit, and parabolas through steps."""

from dataclasses import fields, is_dataclass, replace

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
from marsarm.diagnosis.problem import Sensitivities, fit_parabola, load_sensitivities, save_sensitivities
from simgap.common.errors import BadRequest


def test_a_parabola_goes_through_both_steps_and_one_step_makes_a_line(rng):
    slope, curve = rng.normal(size=(2, 5))
    ends = [(slope * x + curve * x**2, x) for x in (0.5, -0.8)]
    np.testing.assert_allclose(fit_parabola(ends), (slope, curve))
    np.testing.assert_allclose(fit_parabola(ends[:1]), (slope + 0.5 * curve, np.zeros(5)))


@pytest.fixture
def kept(made):
    """Return the sensitivities of a world."""
    return Sensitivities(*(getattr(made, field.name) for field in fields(Sensitivities)))


def test_what_is_kept_comes_back(kept, tmp_path):
    save_sensitivities(tmp_path / "s.npz", kept)
    again = load_sensitivities(tmp_path / "s.npz", kept.hypotheses, kept.nuisances)
    assert _plain(again) == _plain(kept)
    assert [path.name for path in tmp_path.iterdir()] == ["s.npz"]


def _plain(value):
    """Convert nested records to dictionaries."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value.tolist() if isinstance(value, np.ndarray) else value


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_file_that_was_damaged_or_is_something_else_is_refused(kept, tmp_path, share):
    path = tmp_path / "s.npz"
    save_sensitivities(path, kept)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(BadRequest, match=r"s\.npz: no sensitivities .*remove it"):
        load_sensitivities(path, (), ())
    np.savez(path, a=np.zeros(3))
    with pytest.raises(BadRequest, match="no sensitivities"):
        load_sensitivities(path, (), ())


def test_a_robot_that_cannot_be_simulated_has_no_sensitivities(made):
    with pytest.raises(ValueError, match="must be finite"):
        replace(made, effect=np.nan * made.effect)


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

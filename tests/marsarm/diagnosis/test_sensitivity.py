"""Saved sensitivities, and parabolas through simulated steps."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

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

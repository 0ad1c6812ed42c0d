"""Parameters, hypotheses, features and saved sensitivities; errors name the bad input."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from marsarm.diagnosis.problem import Hypothesis, Nuisance, Parameter, Residuals
from marsarm.diagnosis.sensitivity import load_sensitivities, save_sensitivities
from tests.marsarm.diagnosis.worlds import found


def test_sensitivities_are_those_of_the_simulator(made):
    kept = found(made)
    assert np.allclose(kept.effect, made.effect, rtol=1e-9, atol=1e-12)
    assert np.allclose(kept.nuisance, made.nuisance, rtol=1e-9, atol=1e-12)


def test_a_size_with_one_side_is_differentiated_on_that_side(made):
    one = made.hypotheses[0]
    half = replace(one, parameters=tuple(replace(p, least=0.0) for p in one.parameters))
    bent = replace(made, hypotheses=(half, *made.hypotheses[1:]), bent=0.5)
    assert np.allclose(found(bent).effect[:, 0], 1.5 * made.effect[:, 0])


def test_what_is_kept_comes_back(made, tmp_path):
    kept = found(made)
    save_sensitivities(tmp_path / "s.npz", kept)
    again = load_sensitivities(tmp_path / "s.npz")
    assert _plain(again) == _plain(kept)
    assert [path.name for path in tmp_path.iterdir()] == ["s.npz"]


def _plain(value):
    """Convert nested records to dictionaries."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value.tolist() if isinstance(value, np.ndarray) else value


def test_a_file_of_something_else_is_refused(tmp_path):
    np.savez(tmp_path / "s.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="no sensitivities"):
        load_sensitivities(tmp_path / "s.npz")


@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.99])
def test_a_file_that_was_cut_is_refused(made, tmp_path, share):
    save_sensitivities(tmp_path / "s.npz", found(made))
    whole = (tmp_path / "s.npz").read_bytes()
    (tmp_path / "s.npz").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"s\.npz: no sensitivities"):
        load_sensitivities(tmp_path / "s.npz")


@pytest.mark.parametrize(("at", "value"), [(8, 1), (10, 99)])
def test_a_file_whose_directory_says_it_is_locked_or_packed_otherwise_is_refused(made, tmp_path, at, value):
    save_sensitivities(tmp_path / "s.npz", found(made))
    damaged = bytearray((tmp_path / "s.npz").read_bytes())
    damaged[damaged.index(b"PK\x01\x02") + at] = value
    (tmp_path / "s.npz").write_bytes(damaged)
    with pytest.raises(ValueError, match=r"s\.npz: no sensitivities"):
        load_sensitivities(tmp_path / "s.npz")


def test_a_feature_that_is_not_finite_is_named(made):
    value = np.zeros(made.layout.size)
    value[5] = np.nan
    with pytest.raises(ValueError, match=r"feature 5 \(place \d\.[abc]\) is not finite"):
        Residuals(made.layout, value)


def test_a_floor_of_nothing_is_refused(made):
    with pytest.raises(ValueError, match="above 0"):
        replace(made.layout, sigma=0.0 * made.layout.sigma)


def test_what_cannot_be_an_effect_is_refused():
    with pytest.raises(ValueError, match="no parameter has a neutral value"):
        Hypothesis("e", "p", (Parameter("x", "m", 0.0, 1.0, 0.5),))
    with pytest.raises(ValueError, match="within its bounds"):
        Parameter("x", "m", 0.0, 1.0, 0.5, neutral=2.0)
    with pytest.raises(ValueError, match="finite if it is drawn"):
        Nuisance("n", "m", np.inf, random_per_block=True)

"""Out-of-catalogue effects: each changes what it claims to change, and nothing at its neutral value."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sim.arms import BuiltArm, arm_named
from sim.diagnosis_campaign import campaign_sessions, run_session, start_session
from sim.effects.catalogue import EffectHypothesis, catalogue, hypotheses
from sim.effects.effect import Effect
from sim.initialisation import true_reference
from sim.scenario.effects import effect_classes_in_file, effect_text, parse_effect_text
from tests.marks import slow_but
from tests.tools import TOOLS

FOLDER = Path(__file__).parents[3] / "validation" / "out_of_catalogue_effects"
KINDS = {
    kind.__name__: kind for file in sorted(FOLDER.glob("*.py")) for kind in effect_classes_in_file(str(file))
}
NOMINAL = arm_named("nominal")
AT = {"SettlingRover": "y", "RockingLink": "link3.z"}
"""Joint at which an effect shows in the session below; the elbow if not named."""
SHOWN: dict[str, tuple[str, ...]] = {
    "TightSpots": ("current_A",),
    "DraggingBrake": ("current_A",),
    "GreaseAside": ("current_A",),
    "StiffeningGear": ("resolver_rad",),
    "SnaggingCable": ("resolver_rad",),
    "LeakyIntegral": ("encoder_count",),
    "TorqueRipple": ("current_A",),
    "DeadCurrent": ("current_A",),
    "SluggishCurrent": ("current_A",),
    "OvalResolver": ("resolver_rad",),
    "LateResolver": ("resolver_rad",),
    "SettlingRover": (),
    "RockingLink": (),
}
"""Readings that an effect changes."""
EACH = pytest.mark.parametrize("name", KINDS)
FEW = pytest.mark.parametrize("name", slow_but(KINDS, "TightSpots", "SettlingRover"))


def hypothesis_at(name: str) -> EffectHypothesis:
    place = AT.get(name, "elbow")
    return next(one for one in hypotheses({name: KINDS[name]}) if str(one).endswith(place))


@cache
def record_session(*effects: Effect) -> dict[str, np.ndarray]:
    """Return the first readings of a session in which all joints move, and the positions of the turret."""
    session = next(one for one in campaign_sessions(NOMINAL.params) if one.name == "poses-level-1")
    loop = start_session(session, BuiltArm("nominal", effects, NOMINAL.params), true_reference(NOMINAL), 3)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in ("current_A", "encoder_count", "resolver_rad")}
    for number, cycle in enumerate(run_session(loop, session)):
        for name, row in rows.items():
            row.append(getattr(cycle.record.sensors, name))
        if number == 250:
            break
    return {name: np.array(row) for name, row in rows.items()} | {"turret": loop.truth().p_RoTo_R_m[:, 0]}


def differences(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, float]:
    return {name: float(np.abs(one[name] - other[name]).max()) for name in one}


def test_there_are_a_dozen_and_all_are_tested() -> None:
    assert set(KINDS) == set(SHOWN)
    assert len(KINDS) >= 12


@EACH
def test_no_catalogue_has_it_and_it_comes_back_from_what_is_written_of_it(name: str) -> None:
    assert not {str(one).split(":")[0] for one in hypotheses({name: KINDS[name]})} & set(catalogue())
    for one in hypotheses({name: KINDS[name]}):
        assert len(one.amplitudes) == 1
        assert parse_effect_text(effect_text(one.typical()), TOOLS) == one.typical()


@FEW
def test_where_it_is_neutral_it_changes_nothing(name: str) -> None:
    assert all(
        value == 0.0
        for value in differences(record_session(hypothesis_at(name).effect()), record_session()).values()
    )


@FEW
def test_of_its_typical_size_it_shows_and_the_same_each_time(name: str) -> None:
    with_it = record_session(hypothesis_at(name).typical())
    moved = differences(with_it, record_session())
    for reading in SHOWN[name]:
        assert moved[reading] > LEAST[reading], reading
    if not SHOWN[name]:
        assert moved["turret"] > 2e-5
    again = record_session.__wrapped__(hypothesis_at(name).typical())
    assert all(value == 0.0 for value in differences(again, with_it).values())


LEAST = {"current_A": 0.02, "encoder_count": 1, "resolver_rad": 3e-5}


@pytest.mark.parametrize("name", ["DeadCurrent", "SluggishCurrent", "OvalResolver", "LateResolver"])
def test_a_sensor_that_reads_wrong_moves_nothing_at_first(name: str) -> None:
    """Flight software may react to wrong readings later; before the move all else is unchanged."""
    with_it, without = record_session(hypothesis_at(name).typical()), record_session()
    others = {"current_A", "encoder_count", "resolver_rad"} - set(SHOWN[name])
    assert all(np.array_equal(with_it[other][:64], without[other][:64]) for other in others)


def shape(name: str) -> Callable[..., np.ndarray]:
    return lambda **values: record_session(hypothesis_at(name).effect(**values))["current_A"]


def test_twice_the_ripple_is_twice_the_change() -> None:
    ripple, current = shape("TorqueRipple"), record_session()["current_A"]
    once, twice = ripple(share=0.05) - current, ripple(share=0.1) - current
    np.testing.assert_allclose(twice[:100], 2.0 * once[:100], atol=1e-12)

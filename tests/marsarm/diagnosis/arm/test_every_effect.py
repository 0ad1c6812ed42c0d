"""Simulator of the diagnosis with every candidate, at both ends of its sizes."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.diagnosis.arm.arm_effects import list_hypotheses
from marsarm.diagnosis.arm.feature_set import FeatureSet, build_feature_set, simulate_features
from marsarm.diagnosis.arm.logs import Recording
from sim.effects.effect import Effect
from sim.effects.joints import BusSag
from sim.effects.sensors import CounterStart
from sim.loop import SimulationOptions

BRIEF = SimulationOptions(settle_s=1.0)


def candidates_at_ends() -> Iterator[Any]:
    """Yield each kind of candidate at its first place, with its least and with its greatest sizes."""
    for one in {candidate.effect: candidate for candidate in list_hypotheses()}.values():
        ends = np.transpose([parameter.departure_range for parameter in one.parameters])
        for end, departures in zip(("least", "most"), ends, strict=True):
            yield pytest.param(one.switch_on(departures), id=f"{one.key}, {end}")


@pytest.fixture(scope="module")
def features(recordings: list[Recording]) -> FeatureSet:
    """Return the features of a motion of all joints, and of its rests."""
    (recording,) = (one for one in recordings if one.name == "poses-level-1")
    return build_feature_set([recording])


@pytest.mark.slow
@pytest.mark.parametrize("effect", list(candidates_at_ends()))
def test_the_simulator_carries_it(features: FeatureSet, effect: Effect) -> None:
    assert np.all(np.isfinite(simulate_features(features, (effect,), BRIEF)))


def test_two_sagging_buses_leave_servos_without_power_not_with_negative_gains(features: FeatureSet) -> None:
    assert np.all(np.isfinite(simulate_features(features, (BusSag(5.0), BusSag(5.0)), BRIEF)))


def test_where_a_counter_started_before_homing_changes_nothing(features: FeatureSet) -> None:
    found = simulate_features(features, (CounterStart(Joint.ELBOW, 1.0),), BRIEF)
    np.testing.assert_array_equal(found, simulate_features(features, (), BRIEF))

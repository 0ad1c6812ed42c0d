"""Simulator of the diagnosis with every effect of the catalogue, at both bounds of every parameter."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.diagnosis.arm.feature_set import FeatureSet, build_feature_set, simulate_features
from marsarm.diagnosis.arm.logs import Recording
from marsarm.diagnosis.arm.rest_poses import simulate_open_loop, stack_readings
from sim.effects.catalogue import (
    ParameterField,
    all_places,
    catalogue,
    effect_name,
    effect_place_text,
    parameters_of,
)
from sim.effects.effect import Effect
from sim.effects.faults import SensorFault
from sim.effects.joints import BusSag
from sim.effects.sensors import CounterStart
from sim.loop import SimulationOptions

BRIEF = SimulationOptions(settle_s=1.0)


def effects_at_bounds() -> Iterator[Any]:
    """Yield each effect of the catalogue at the first place where it can be."""
    for kind in catalogue().values():
        for values in values_at_bounds(parameters_of(kind)):
            for place in all_places(kind):
                try:
                    effect = kind(**place, **values)
                except ValueError:  # an effect may refuse a bound at some places
                    continue
                numbers = (f"{field}={value:g}" for field, value in values.items() if np.isscalar(value))
                label = (effect_name(kind), effect_place_text(kind, place), *numbers)
                yield pytest.param(effect, id=":".join(label))
                break


def values_at_bounds(parameters: tuple[ParameterField, ...]) -> Iterator[dict[str, Any]]:
    """Yield the parameters with one of them at each of its bounds; the others are typical."""
    usual = {p.field: typical_value(p) for p in parameters}
    bounded = [(p, p.spec) for p in parameters if p.spec is not None]
    for parameter, spec in bounded:
        for bound in (spec.low, spec.high):
            value = bound if parameter.count == 1 else (bound,) * parameter.count
            yield usual | {parameter.field: value}
    if not bounded:
        yield usual


def typical_value(parameter: ParameterField) -> Any:
    if parameter.default is not None or parameter.spec is None:
        return parameter.default
    value = (parameter.spec.neutral or 0.0) + parameter.spec.typical
    return value if parameter.count == 1 else (value,) * parameter.count


@pytest.fixture(scope="module")
def recording(recordings: list[Recording]) -> Recording:
    """Return the recording of one motion of all joints."""
    return next(one for one in recordings if one.name == "poses-level-1")


@pytest.fixture(scope="module")
def features(recording: Recording) -> FeatureSet:
    """Return the features of the motion and of its rests."""
    return build_feature_set([recording])


def carries(recording: Recording, features: FeatureSet, *effects: Effect) -> bool:
    """Return whether all readings up to the end are finite, and all features that are compared."""
    readings = simulate_open_loop(recording, effects, BRIEF).readings
    predicted = simulate_features(features, effects, BRIEF)
    columns = (*stack_readings(readings).values(), predicted)
    return len(readings) == recording.ticks and all(bool(np.all(np.isfinite(c))) for c in columns)


@pytest.mark.slow
@pytest.mark.parametrize("effect", list(effects_at_bounds()))
def test_the_simulator_of_the_diagnosis_carries_it(
    recording: Recording, features: FeatureSet, effect: Effect
) -> None:
    reads_nan = isinstance(effect, SensorFault) and effect.kind == "nan" and effect.at_s == 0.0
    assert carries(recording, features, effect) is not reads_nan


def test_two_sagging_buses_leave_servos_without_power_not_with_negative_gains(
    recording: Recording, features: FeatureSet
) -> None:
    assert carries(recording, features, BusSag(5.0), BusSag(5.0))


def test_where_a_counter_started_before_homing_changes_nothing(features: FeatureSet) -> None:
    found = simulate_features(features, (CounterStart(Joint.ELBOW, 1.0),), BRIEF)
    np.testing.assert_array_equal(found, simulate_features(features, (), BRIEF))

"""Out-of-catalogue effects: each changes what it claims to change, and nothing at its neutral value."""

from contextlib import suppress
from functools import cache
from itertools import chain, islice
from pathlib import Path

import numpy as np
import pytest

from fsw.config import CYCLE_HZ
from helpers.marks import slow_but
from sim.arms import BuiltArm, arm_named
from sim.diagnosis_campaign import SessionFailed, campaign_sessions, run_session, start_session
from sim.effects.catalogue import EffectHypothesis, catalogue, hypotheses
from sim.effects.effect import Effect
from sim.initialisation import true_reference
from sim.scenario.effects import effect_classes_in_file, effect_text, parse_effect_text
from tests.tools import TOOLS

FOLDER = Path(__file__).parents[3] / "validation" / "out_of_catalogue_effects"
FOUND = {file.stem: effect_classes_in_file(str(file)) for file in sorted(FOLDER.glob("*.py"))}
"""Effects by file."""
KINDS = {kind.__name__: kind for kinds in FOUND.values() for kind in kinds}
NOMINAL = arm_named("nominal")
AT = {
    "TwoJointCable": "wrist",
    "TwistUnderBending": "link3.z",
    "OpeningFlange": "link3.z.positive",
    "LiftingWheel": "y",
    "VibratedImu": "x",
    "SteadyWind": "link3.x",
    "SwayingRover": "y",
}
"""Place at which an effect shows in the session below; the elbow if not named."""
SENSORS = {
    "SaturatingMotor": "current_A",
    "DriftingCurrent": "current_A",
    "MagneticResolver": "resolver_rad",
    "HeaterOnLine": "current_A",
    "RemanentCore": "current_A",
    "WrongBit": "resolver_rad",
    "VibratedImu": "gravity_R_m_s2",
}
"""Effects that change readings only, and which."""
MOVERS = {
    "current_A": ("ChurningGrease", "SharedSeal", "TwoJointCable", "Dither", "FeedForward"),
    "resolver_rad": ("ChippedTooth", "UnevenMesh", "TwoJointCable", "SlippingBelt"),
    "encoder_count": ("FilteredSetpoint", "DeadBand", "Dither", "FeedForward", "KickingBrake"),
    "turret": (
        "TwistUnderBending",
        "OpeningFlange",
        "LiftingWheel",
        "ScrewingBearing",
        "SteadyWind",
        "SwayingRover",
    ),
}
"""Other effects, by the readings that they change or the turret that they move."""
READINGS = ("current_A", "encoder_count", "resolver_rad", "gravity_R_m_s2")
LEAST = {"current_A": 0.02, "encoder_count": 1, "resolver_rad": 3e-5, "gravity_R_m_s2": 3e-3, "turret": 2e-5}
EACH = pytest.mark.parametrize("name", KINDS)
FEW = pytest.mark.parametrize("name", slow_but(KINDS, "ChurningGrease", "SwayingRover"))
FILES = pytest.mark.parametrize("file", FOUND)


def hypothesis_at(name: str) -> EffectHypothesis:
    place = AT.get(name, "elbow")
    return next(one for one in hypotheses({name: KINDS[name]}) if str(one).endswith(f":{place}"))


@cache
def record_session(*effects: Effect) -> dict[str, np.ndarray]:
    """Return the first readings of a session in which all joints move, and the positions of the turret.

    A wrong reading may end the move early, as the resolver's that looks like the torque of an obstacle.
    """
    session = next(one for one in campaign_sessions(NOMINAL.params) if one.name == "poses-level-1")
    loop = start_session(session, BuiltArm("nominal", effects, NOMINAL.params), true_reference(NOMINAL), 3)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in READINGS}
    with suppress(SessionFailed):
        for cycle in islice(run_session(loop, session), 251):
            for name, row in rows.items():
                row.append(getattr(cycle.record.sensors, name))
    return {name: np.array(row) for name, row in rows.items()} | {"turret": loop.truth().p_RoTo_R_m[:, 0]}


def differences(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the largest difference of each reading in the shorter session, and of the turret."""
    least = min(len(one["current_A"]), len(other["current_A"]))
    return {name: float(np.abs(one[name][:least] - other[name][:least]).max()) for name in one}


def test_there_are_two_dozen_and_all_are_tested():
    assert {file: len(kinds) for file, kinds in FOUND.items()} == {"related": 12, "unrelated": 12}
    assert len(KINDS) == 24
    assert set(KINDS) == {*SENSORS, *chain(*MOVERS.values())}


@EACH
def test_no_catalogue_has_it_and_it_comes_back_from_what_is_written_of_it(name):
    assert not {str(one).split(":")[0] for one in hypotheses({name: KINDS[name]})} & set(catalogue())
    places = list(hypotheses({name: KINDS[name]}))
    assert len(places) >= 2
    for one in places:
        assert len(one.amplitudes) == 1
        assert parse_effect_text(effect_text(one.typical()), TOOLS) == one.typical()


@FILES
def test_where_they_are_neutral_they_change_nothing(file):
    """All effects of a file are neutral at all of their places at once."""
    everywhere = (one.effect() for one in hypotheses({kind.__name__: kind for kind in FOUND[file]}))
    assert all(value == 0.0 for value in differences(record_session(*everywhere), record_session()).values())


@FEW
def test_of_its_typical_size_it_shows_and_the_same_each_time(name):
    with_it = record_session(hypothesis_at(name).typical())
    moved = differences(with_it, record_session())
    for reading, least in LEAST.items():
        if name in MOVERS.get(reading, ()) or SENSORS.get(name) == reading:
            assert moved[reading] > least, reading
    again = record_session.__wrapped__(hypothesis_at(name).typical())
    assert all(value == 0.0 for value in differences(again, with_it).values())


@pytest.mark.parametrize("name", slow_but(SENSORS, *list(SENSORS)[::2]))
def test_a_sensor_that_reads_wrong_moves_nothing_at_first(name):
    """Flight software may react to wrong readings later; before the move all else is unchanged."""
    with_it, without = record_session(hypothesis_at(name).typical()), record_session()
    others = set(READINGS) - {SENSORS[name]}
    assert all(np.array_equal(with_it[other][:64], without[other][:64]) for other in others)


def change(name: str, reading: str, times: float) -> np.ndarray:
    with_it = record_session(hypothesis_at(name).typical(times))
    moved: np.ndarray = with_it[reading] - record_session()[reading]
    return moved


def test_a_current_drifts_with_time_and_a_heater_is_on_or_off():
    drifted_A, heater_A = (
        change(name, "current_A", 1.0)[:, 2] for name in ("DriftingCurrent", "HeaterOnLine")
    )
    np.testing.assert_allclose(drifted_A, 6e-3 * np.arange(1, len(drifted_A) + 1) / CYCLE_HZ, atol=1e-12)
    on = np.arange(1, len(heater_A) + 1) >= 2.5 * CYCLE_HZ
    np.testing.assert_allclose(heater_A, 0.05 * on, atol=1e-12)

"""Logs of blind cases do not reveal the plant; a log that does is deleted."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.diagnosis.arm import demo
from marsarm.diagnosis.arm.arm_effects import list_hypotheses
from marsarm.diagnosis.arm.logs import load_recording
from marsarm.diagnosis.arm.record import session_json
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import SESSION, Recorder, flight_header, run_header
from sim.arm_model.load import default_arm
from sim.arms import arm_named
from sim.diagnosis_campaign import run_session, start_session
from sim.effects.effect import nominal_hardware
from sim.effects.environment import Numerics
from sim.effects.gears import CoulombFriction
from sim.effects.joints import GearFriction
from sim.initialisation import true_reference
from sim.scenario.effects import effect_text
from sim.tolerances import draw_calibration_errors
from tests.tools import TOOLS
from validation.cases import arm, arm_truth
from validation.cases.sealed import CASES_FOLDER, record_case

pytestmark = pytest.mark.slow

MAKER = arm.ArmCases(("cold",))
SESSIONS = arm.choose_sessions(MAKER.sessions)


def cases(kinds=("single", "out-of-catalogue")):
    """Return one case of each kind, with effects that need no campaign."""
    catalogue = [
        demo.DetectableEffect(one, 0.4, number)
        for number, one in enumerate(list_hypotheses())
        if one.key in ("elbow: coulomb-friction", "wrist: backlash-width")
    ]
    unknown = [one for (name, _), one in arm_truth.list_uncatalogued().items() if name == "drifting-current"]
    outside = [demo.DetectableEffect(one, 0.4, None) for one in unknown]
    truth = arm.draw_truth(10, 1, catalogue, outside)
    return {kind: next(case for case in truth if case.kind == kind) for kind in kinds}


Recorded = tuple[Path, arm_truth.TrueCase]


@pytest.fixture(scope="module", params=["single", "out-of-catalogue"])
def recorded(request, tmp_path_factory):
    folder, case = tmp_path_factory.mktemp("case"), cases()[request.param]
    MAKER.record(folder, case)
    return folder / "cold.mcap", case


def test_every_arm_has_errors_of_its_own_and_is_computed_otherwise():
    one, again, other = (demo.sample_background(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one == again != other
    assert sum(isinstance(effect, GearFriction) for effect in one) == 5
    assert any(isinstance(effect, Numerics) for effect in one)
    assert len(one) == len(draw_calibration_errors(default_arm(), 0)) + 11


def test_a_blind_log_gives_nothing_away_and_can_be_compared(recorded):
    path, case = recorded
    arm_truth.check_leakage(path, case)
    log = read_log(path)
    assert set(log.header) <= arm_truth.ALLOWED_KEYS
    assert "/truth" not in log.packets
    here = load_recording(path)
    assert (here.name, here.params.arm_name) == ("cold", "nominal")
    assert not np.isclose(here.start.zero_rad, nominal_hardware().counter_zero_rad).any()


@pytest.mark.slow
def test_a_case_that_is_made_again_is_the_same(recorded, tmp_path):
    path, case = recorded
    MAKER.record(tmp_path, case)
    one, again = read_log(path), read_log(tmp_path / path.name)
    assert one.header == again.header
    assert one.packets.keys() == again.packets.keys()
    assert all(np.array_equal(one[topic], again[topic]) for topic in one.packets)


CASE = arm_truth.TrueCase("case-000", "none", (), ("gear-stiffness:elbow:factor=1.0312345678",), 1234567890)
LEAKS: dict[str, Callable[..., dict[str, str]]] = {
    "says seed": lambda said: {**said, "seed": "1"},
    "says arm, effects, mjcf_sha256, request, seed": lambda said: said,
    "'calibrated:'": lambda said: {**said, "git": "calibrated:17"},
    "'1234567890'": lambda said: {**said, "git": "1234567890"},
    "'gear-stiffness'": lambda said: {**said, SESSION: '{"note": "gear-stiffness"}'},
    "a number of its truth": lambda said: {**said, "commands": "[1.0312345678]"},
}


@pytest.mark.parametrize("words", LEAKS)
def test_a_header_that_reveals_the_truth_is_refused(words, tmp_path):
    loop = start_session(SESSIONS[0], arm_named("nominal"), true_reference(arm_named("nominal")), 1)
    whole = words.startswith("says arm")
    said = run_header(loop, "nominal", 1, {}, ()) if whole else flight_header(loop, ())
    path = tmp_path / "x.mcap"
    with Recorder(path, LEAKS[words]({**said, SESSION: session_json(SESSIONS[0])})) as recorder:
        recorder.write(loop.cycle())
    with pytest.raises(arm_truth.TruthLeaked, match=words):
        arm_truth.check_leakage(path, CASE)


def test_the_plants_own_state_is_refused(tmp_path):
    loop = start_session(SESSIONS[0], arm_named("nominal"), true_reference(arm_named("nominal")), 1)
    loop.with_truth = True
    path = tmp_path / "x.mcap"
    with Recorder(path, {**flight_header(loop, ()), SESSION: session_json(SESSIONS[0])}) as recorder:
        recorder.write(next(run_session(loop, SESSIONS[0])).record)
    with pytest.raises(arm_truth.TruthLeaked, match="the plant's own state in /truth"):
        arm_truth.check_leakage(path, CASE)


def test_a_case_with_a_revealing_log_is_deleted(tmp_path, monkeypatch):
    """A perfect homing would measure the friction that is the case's effect."""
    monkeypatch.setattr(demo, "blind_reference", lambda built, _: true_reference(built))
    case = replace(cases()["single"], background=(effect_text(CoulombFriction(Joint.ELEVATION, 12.0)),))
    with pytest.raises(arm_truth.TruthLeaked, match=r"flight software begins with friction_Nm"):
        record_case((tmp_path / CASES_FOLDER / case.name, MAKER, case))
    assert list((tmp_path / "cases").iterdir()) == []


@pytest.mark.slow
def test_a_case_is_there_whole_or_not_at_all(tmp_path, monkeypatch):
    case = cases()["single"]

    def stopped(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as broken:
        broken.setattr(arm, "check_leakage", stopped)
        with pytest.raises(KeyboardInterrupt):
            record_case((tmp_path / CASES_FOLDER / case.name, MAKER, case))
    assert list((tmp_path / "cases").iterdir()) == []
    assert record_case((tmp_path / CASES_FOLDER / case.name, MAKER, case)) == case.name
    assert [path.name for path in (tmp_path / "cases" / case.name).iterdir()] == ["cold.mcap"]


def test_an_effect_from_outside_is_written_by_its_file_and_switched_on():
    (effect,) = cases()["out-of-catalogue"].effects
    assert effect.spec.startswith("related.py:DriftingCurrent:")
    made = arm_truth.resolve_effect(effect.spec, TOOLS)
    assert {"drift_A_s": getattr(made, "drift_A_s", None)} == effect.values
    assert arm_truth.resolve_effect(effect.spec.replace("related.py", "related/sensors.py"), TOOLS) == made


def test_a_session_that_does_not_complete_is_left_out(tmp_path):
    weak = ("servo-gain:elbow:factor=0.1", "coulomb-friction:elbow:torque_Nm=400")
    case = arm_truth.TrueCase("case-000", "none", (), weak, 5)
    MAKER.record(tmp_path, case)
    assert list(tmp_path.rglob("*.mcap")) == []

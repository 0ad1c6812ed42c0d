"""A whole diagnosis of an arm, in small: which of two effects it is, how large, and what is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.dictionary.enums import Frame, Joint
from ground.common.pool import local_runner
from ground.diagnosis.arm import sensitivities, settled
from ground.diagnosis.arm.bound import Bound, asked_again
from ground.diagnosis.arm.case import TooLittleMotion, asked, solved
from ground.diagnosis.arm.diagnosed import diagnosed
from ground.diagnosis.arm.logs import NotForDiagnosis, recording_in
from ground.diagnosis.arm.record import record_campaign
from ground.diagnosis.arm.reference import Reference, reference
from ground.diagnosis.arm.request import DiagnoseRequest
from ground.diagnosis.result import Result
from ground.diagnosis.sensitivity import Sensitivities
from sim.arms import CALIBRATED_FRAME_SIGMA_M, arm_named
from sim.diagnosis_campaign import campaign_sessions
from sim.effects.effect import Effect
from sim.effects.geometry import FrameError
from sim.effects.joints import ResolverBias
from sim.effects.links import LinkLength
from sim.initialisation import true_reference
from sim.plant import PlantDiverged

FITTED = ("poses-level-1", "poses-level-1-again", "poses-level-2", "poses-rolled-1")
APART = ("poses-level-3", "poses-rolled-2")
KINDS = ("resolver-bias", "link-length")
Logs = tuple[list[Path], list[Path]]


def silent(*_: object) -> None:
    """No progress."""


def recorded(folder: Path, effects: tuple[Effect, ...], seed: int) -> Logs:
    arm = arm_named("nominal").with_effects(effects)
    chosen = [one for one in campaign_sessions(arm.params) if one.name in FITTED + APART]
    paths = record_campaign(folder, chosen, arm, true_reference(arm_named("nominal")), seed, silent)
    return [p for p in paths if p.stem in FITTED], [p for p in paths if p.stem in APART]


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> Logs:
    """Logs of the arm that the simulator is."""
    return recorded(tmp_path_factory.mktemp("nominal"), (), 1)


@pytest.fixture(scope="module")
def against(nominal: Logs, tmp_path_factory: pytest.TempPathFactory) -> Reference:
    """What is known of the campaign before cases."""
    return reference(*nominal, tmp_path_factory.mktemp("kept"), local_runner(1), silent, KINDS)


@pytest.fixture
def case(against: Reference, tmp_path: Path) -> Callable[..., Result]:
    """What is said of an arm with these effects, beside a simulator with those of a patch."""

    def of(*effects: Effect, patch: tuple[Effect, ...] = ()) -> Result:
        fitted, apart = ([recording_in(p) for p in paths] for paths in recorded(tmp_path, effects, 9))
        return solved(fitted, apart, against, 0, patch)

    return of


@pytest.mark.parametrize("effect", [ResolverBias(Joint.ELBOW, 5e-3), LinkLength(Frame.ARM3, "x", 5e-3)])
def test_the_effect_is_named_with_its_size_and_closes_the_gap(
    case: Callable[..., Result], effect: ResolverBias | LinkLength
) -> None:
    said = case(effect)
    (finding,) = said.diagnosis.findings
    hypothesis = said.ready.found.hypotheses[finding.hypothesis]
    size = effect.bias_rad if isinstance(effect, ResolverBias) else effect.length_m
    assert said.diagnosis.verdict == "named"
    assert hypothesis.name.startswith("resolver-bias" if isinstance(effect, ResolverBias) else "link-length")
    assert finding.values[0] == pytest.approx(size, rel=0.1)
    assert said.closure is not None
    assert said.closure.share > 0.8


def test_nuisances_do_not_take_the_place_of_an_effect_that_they_are_like(
    against: Reference, tmp_path: Path
) -> None:
    """The simulator is asked about them: had they the effect, it would bend as if it were there twice."""
    logs = recorded(tmp_path, (LinkLength(Frame.ARM3, "x", 5e-3),), 9)
    fitted, apart = ([recording_in(path) for path in paths] for paths in logs)
    here = asked(fitted, apart, against)
    shifts = [e.screw[3:] for e in here.case.arm.patch if isinstance(e, FrameError) and e.frame is Frame.ARM3]
    assert shifts
    assert np.abs(shifts).max() < 4.0 * CALIBRATED_FRAME_SIGMA_M


def test_the_simulator_is_asked_only_about_nuisances_that_an_arm_may_have(
    against: Reference, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone they stand for an effect that is like them, however large: springs as soft would be no arm."""
    logs = recorded(tmp_path, (LinkLength(Frame.ARM3, "x", 0.05),), 9)
    shifts: list[np.ndarray] = []

    def noted(case: Bound, near: tuple[Effect, ...], *rest: Any) -> Bound:
        shifts.extend(effect.screw[3:] for effect in near if isinstance(effect, FrameError))
        return asked_again(case, near, *rest)

    monkeypatch.setattr(settled, "asked_again", noted)
    asked([recording_in(path) for path in logs[0]], [], against)
    assert 9.0 * CALIBRATED_FRAME_SIGMA_M < np.abs(shifts).max() < 10.1 * CALIBRATED_FRAME_SIGMA_M


def test_a_rival_that_is_no_arm_has_lost(
    against: Reference, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = recorded(tmp_path, (LinkLength(Frame.ARM3, "x", 5e-3),), 9)
    fitted = [recording_in(path) for path in logs[0]]

    def diverged(*_: object) -> None:
        raise PlantDiverged("bad qacc")

    monkeypatch.setattr("ground.diagnosis.arm.settled._near", lambda known, alone, chosen: (0,))
    fought = asked(fitted, [], against)
    assert fought.duel is not None
    assert fought.duel.rival == (0,)
    monkeypatch.setattr("ground.diagnosis.arm.settled._fitted", diverged)
    assert asked(fitted, [], against).duel is None


def test_with_the_patch_on_nothing_is_left(case: Callable[..., Result]) -> None:
    effect = LinkLength(Frame.ARM3, "x", 3e-3)
    said = case(effect, patch=(effect,))
    assert said.diagnosis.verdict == "none"
    assert said.tool is not None
    assert said.tool.before_mm < 2.0 * said.tool.floor_mm


def test_most_of_a_campaign_must_be_there(nominal: Logs, against: Reference) -> None:
    few = [recording_in(path) for path in nominal[0][:1]]
    with pytest.raises(TooLittleMotion, match=r"poses-level-2, poses-rolled-1"):
        solved(few, [], against, 0)


def test_a_campaign_without_such_sessions_is_refused(nominal: Logs, tmp_path: Path) -> None:
    request = DiagnoseRequest(tuple(nominal[0]), campaign=tmp_path)
    with pytest.raises(NotForDiagnosis, match="has no session poses-level-1, poses-level-1-again"):
        diagnosed(request, silent)


def test_a_part_of_the_effects_is_taken_from_what_is_kept_of_all(
    nominal: Logs, against: Reference, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def computed(*_: object) -> Sensitivities:
        return found.pop()

    found = [against.ready.found]
    monkeypatch.setattr(sensitivities, "_found", computed)
    whole, part = (
        sensitivities.arm_sensitivities(nominal[0], tmp_path, local_runner(1), silent, kinds)
        for kinds in (None, KINDS[:1])
    )
    assert not found
    assert {hypothesis.effect for hypothesis in whole.found.hypotheses} == set(KINDS)
    assert {hypothesis.effect for hypothesis in part.found.hypotheses} == {KINDS[0]}
    np.testing.assert_array_equal(part.found.nuisance, whole.found.nuisance)
    assert part.keys() == whole.keys()


def test_sessions_that_are_missing_are_said(nominal: Logs, against: Reference) -> None:
    some = [recording_in(path) for path in nominal[0] if path.stem != "poses-level-2"]
    said = asked(some, [], against).notes
    assert "of the campaign's motions nothing comparable is there of poses-level-2" in said

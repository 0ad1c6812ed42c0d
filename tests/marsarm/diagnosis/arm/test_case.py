"""Small diagnosis of an arm: which of two effects, how large, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.dictionary.enums import Frame, Joint
from marsarm.common.pool import local_runner
from marsarm.diagnosis.arm import case_simulator
from marsarm.diagnosis.arm.case import CampaignModel, diagnose_case, load_campaign_model
from marsarm.diagnosis.arm.case_simulator import CaseSimulator, resimulate
from marsarm.diagnosis.arm.diagnose_logs import diagnose
from marsarm.diagnosis.arm.logs import NotForDiagnosis, Recording, load_recording
from marsarm.diagnosis.arm.record import record_campaign
from marsarm.diagnosis.arm.request import DiagnoseRequest
from sim.arm_model.load import default_arm
from sim.arms import arm_named
from sim.diagnosis_campaign import campaign_sessions
from sim.effects.effect import Effect
from sim.effects.geometry import FrameError, LinkLength
from sim.effects.joints import ResolverBias
from sim.initialisation import true_reference
from simgap import Diagnosis, JointError
from simgap.common.progress import no_progress

pytestmark = pytest.mark.slow

FITTED = ("poses-level-1", "poses-level-1-again", "poses-level-2", "poses-rolled-1")
APART = ("poses-level-3", "poses-rolled-2")
KINDS = ("resolver-bias", "link-warming", "link-length")
"""A warm link is as one that is too long, but cannot be as long."""
LONG_LINK = LinkLength(Frame.ARM3, "x", 5e-3)
Logs = tuple[list[Path], list[Path]]

CALIBRATED_FRAME_SIGMA_M = default_arm().description.tolerances.calibrated.frame_m


def recorded(folder: Path, effects: tuple[Effect, ...], seed: int, name: str = "nominal") -> Logs:
    arm = arm_named(name).with_effects(effects)
    chosen = [one for one in campaign_sessions(arm.params) if one.name in FITTED + APART]
    paths = record_campaign(folder, chosen, arm, true_reference(arm_named(name)), seed, no_progress)
    return [p for p in paths if p.stem in FITTED], [p for p in paths if p.stem in APART]


@pytest.fixture(scope="module")
def nominal(tmp_path_factory: pytest.TempPathFactory) -> Logs:
    """Record the nominal arm."""
    return recorded(tmp_path_factory.mktemp("nominal"), (), 1)


@pytest.fixture(scope="module")
def against(nominal: Logs, tmp_path_factory: pytest.TempPathFactory) -> CampaignModel:
    """Load the campaign model."""
    return load_campaign_model(*nominal, tmp_path_factory.mktemp("kept"), local_runner(1), no_progress, KINDS)


def loaded(folder: Path, *effects: Effect, name: str = "nominal") -> tuple[list[Recording], list[Recording]]:
    sides, arm = recorded(folder, effects, 9, name), arm_named(name).model
    fitted, apart = ([load_recording(path, arm) for path in paths] for paths in sides)
    return fitted, apart


@pytest.fixture(scope="module")
def long_link(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Recording], list[Recording]]:
    """Record an arm with a link that is 5 mm too long."""
    return loaded(tmp_path_factory.mktemp("long"), LONG_LINK)


def is_named(said: Diagnosis, name: str, size: float) -> bool:
    """Check that the effect is found with its size, and closes the gap."""
    (finding,) = said.findings
    assert said.closure is not None
    assert said.closure > 0.95
    assert finding.size[0] == pytest.approx(size, rel=0.1)
    return len(finding.effects) == 1 and finding.effect == name


def tool_error(said: Diagnosis) -> JointError:
    return next(one for one in said.errors if one.joint == "tool")


def test_a_bias_is_named_with_its_size_and_closes_the_gap(against, tmp_path):
    said = diagnose_case(*loaded(tmp_path, ResolverBias(Joint.ELBOW, 5e-3)), against, 0).diagnosis
    assert is_named(said, "resolver-bias", 5e-3)


def test_a_long_link_is_named_and_no_nuisance_takes_its_place(against, long_link):
    """Fitted alone, nuisances would move the tool back by the 5 mm.

    They are resimulated: with the effect in them, the response would be that of twice the effect.
    """
    said = diagnose_case(*long_link, against, 0).diagnosis
    assert is_named(said, "link-length", 5e-3)
    tool = tool_error(said)
    assert tool.base == pytest.approx(5e-3, abs=5e-4)
    assert tool.explained < 2.0 * tool.noise_floor


def test_with_the_patch_on_nothing_is_left(against, long_link):
    said = diagnose_case(*long_link, against, 0, (LONG_LINK,)).diagnosis
    assert not said.findings
    assert not said.remaining
    assert tool_error(said).base < 2.0 * tool_error(said).noise_floor


def test_only_nuisances_that_an_arm_may_have_are_simulated(against, tmp_path, monkeypatch):
    """Fitted alone they imitate a similar effect, however large: no arm has springs so soft."""
    fitted, _ = loaded(tmp_path, LinkLength(Frame.ARM3, "x", 0.05))
    shifts: list[np.ndarray] = []

    def noted(case: CaseSimulator, near: tuple[Effect, ...], *rest: Any) -> CaseSimulator:
        shifts.extend(effect.screw[3:] for effect in near if isinstance(effect, FrameError))
        return resimulate(case, near, *rest)

    monkeypatch.setattr(case_simulator, "resimulate", noted)
    diagnose_case(fitted, [], against, 0)
    assert 9.0 * CALIBRATED_FRAME_SIGMA_M < np.abs(shifts).max() < 10.1 * CALIBRATED_FRAME_SIGMA_M


def test_an_effect_of_another_arm_is_named(tmp_path):
    """One of its tools has a name that the default arm has not, and nuisances of its own."""
    campaign = recorded(tmp_path / "campaign", (), 1, "m2020")
    model = load_campaign_model(*campaign, tmp_path / "kept", local_runner(1), no_progress, KINDS, "m2020")
    logs = loaded(tmp_path / "case", LONG_LINK, name="m2020")
    assert is_named(diagnose_case(*logs, model, 0).diagnosis, "link-length", 5e-3)
    assert any("frame pixl." in one.name for one in model.model.sensitivities.nuisances)


def test_most_of_a_campaign_must_be_there(nominal, against):
    few = [load_recording(path) for path in nominal[0][:1]]
    with pytest.raises(NotForDiagnosis, match=r"poses-level-2, poses-rolled-1"):
        diagnose_case(few, [], against, 0)


def test_a_campaign_without_such_sessions_is_refused(nominal, tmp_path):
    with pytest.raises(NotForDiagnosis, match="has no session poses-level-1, poses-level-1-again"):
        diagnose(DiagnoseRequest(tuple(nominal[0]), campaign=tmp_path))


def test_missing_sessions_are_noted(nominal, against):
    some = [load_recording(path) for path in nominal[0] if path.stem != "poses-level-2"]
    said = diagnose_case(some, [], against, 0).diagnosis.remarks
    assert "these logs have nothing comparable to the campaign's motions poses-level-2." in said

"""Recorded sessions of the nominal arm."""

from pathlib import Path

import pytest

from marsarm.diagnosis.arm.logs import Recording, load_recording
from marsarm.diagnosis.arm.record import record_campaign
from sim.arms import arm_named
from sim.diagnosis_campaign import campaign_sessions
from sim.initialisation import true_reference

SHOWN = ("poses-level-1", "poses-level-1-again", "place-apxs")


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Record three sessions of the nominal arm."""
    arm = arm_named("nominal")
    chosen = [session for session in campaign_sessions(arm.params) if session.name in SHOWN]
    folder = tmp_path_factory.mktemp("campaign")
    return record_campaign(folder, chosen, arm, true_reference(arm), 4, lambda *_: None)


@pytest.fixture(scope="session")
def recordings(logs: list[Path]) -> list[Recording]:
    """Load the recordings."""
    return [load_recording(path) for path in logs]

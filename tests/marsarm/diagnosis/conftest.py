"""Small synthetic campaign that all tests share, a diagnosis of each verdict, and recorded sessions."""

from pathlib import Path

import numpy as np
import pytest

from marsarm.diagnosis.arm.logs import Recording, load_recording
from marsarm.diagnosis.arm.record import record_campaign
from marsarm.diagnosis.model import alias_cosines, build_model
from sim.arms import arm_named
from sim.diagnosis_campaign import campaign_sessions
from sim.initialisation import true_reference
from tests.marsarm.diagnosis.worlds import select_and_diagnose, sized, strange, world


@pytest.fixture(scope="session")
def made():
    """Return a linear world."""
    return world()


@pytest.fixture(scope="session")
def campaign(made):
    """Return its diagnosis model."""
    return build_model(made)


@pytest.fixture(scope="session")
def results(made, campaign):
    """Return a diagnosis of each verdict, by the name of its case."""
    lone = next(h for h in range(20, 40) if len(campaign.equivalence_class(h)) == 1)
    is_apart = campaign.label[:, None] != campaign.label[None, :]
    cosines = np.where(is_apart, alias_cosines(campaign.equations), 0.0)
    similar = int(np.argmax(cosines.max(axis=1)))
    cases = {
        "named": (1, sized(made, campaign, lone, 6.0), 0.0),
        "alike": (1, sized(made, campaign, 4, 4.0), 0.0),
        "undecided": (4, sized(made, campaign, similar, 2.0), 0.0),
        "nothing": (2, None, 0.0),
        "unknown": (3, None, 3.0 * strange(made)),
        "beside": (3, sized(made, campaign, 4, 8.0), strange(made)),
    }
    return {
        name: select_and_diagnose(campaign, made.measured(np.random.default_rng(seed), t, seed) + extra)
        for name, (seed, t, extra) in cases.items()
    }


@pytest.fixture
def rng():
    """Return a generator with the same draws in every test."""
    return np.random.default_rng(7)


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

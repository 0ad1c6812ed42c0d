"""One small made-up campaign, ready for cases, that all tests share."""

import numpy as np
import pytest

from ground.gap.ready import ready
from tests.ground.gap.worlds import found, world


@pytest.fixture(scope="session")
def made():
    """A linear world."""
    return world()


@pytest.fixture(scope="session")
def campaign(made):
    """Ready for data; thresholds from its own simulated cases."""
    return ready(found(made), seed=1, cases=80)


@pytest.fixture
def rng():
    """The same draws in every test."""
    return np.random.default_rng(7)

"""Small synthetic campaign that all tests share."""

import numpy as np
import pytest

from tests.marsarm.diagnosis import results as cases
from tests.marsarm.diagnosis.worlds import found, modelled, world


@pytest.fixture(scope="session")
def made():
    """Return a linear world."""
    return world()


@pytest.fixture(scope="session")
def campaign(made):
    """Return its diagnosis model."""
    return modelled(found(made))


@pytest.fixture(scope="session")
def results(made, campaign):
    """Return a result of each kind, by its name."""
    kinds = (cases.named, cases.alike, cases.undecided, cases.nothing, cases.unknown, cases.beside)
    return {kind.__name__: kind(made, campaign) for kind in kinds}


@pytest.fixture
def rng():
    """Return a generator with the same draws in every test."""
    return np.random.default_rng(7)

"""Plugin of all tests: one thread for linear algebra, repeatable properties, where real data is."""

import gc
import os
from pathlib import Path

# Before numpy is imported anywhere: the arrays are small, and the test workers fill the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

import simgap  # noqa: F401  before pytest takes the folder simgap/ for a package

# A failure must come back on the next run, on any machine, however loaded.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.register_profile("short", settings.get_profile("repeatable"), max_examples=40)

DATA_VARIABLE = "MARSARM_DATA"


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    from helpers.scheduling import Scheduling  # tests may run without xdist

    return Scheduling(config, log)


def pytest_configure(config):
    gc.disable()  # until all is collected
    settings.load_profile("short" if config.option.markexpr == "not slow" else "repeatable")


@pytest.fixture(scope="session")
def real_data():
    """The folder with measured data; tests that need it are marked `real_data` and skipped without it."""
    return Path(os.environ[DATA_VARIABLE])


def pytest_collection_modifyitems(items):
    folder = os.environ.get(DATA_VARIABLE)
    if folder and Path(folder).is_dir():
        return
    skip = pytest.mark.skip(reason=f"{DATA_VARIABLE} does not name a folder with measured data")
    for item in items:
        if "real_data" in item.keywords:
            item.add_marker(skip)


def pytest_collection_finish():
    """Leave what was collected out of later garbage collections, which would look through it each time."""
    gc.enable()
    gc.collect()
    gc.freeze()

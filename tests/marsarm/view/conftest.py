"""One short recorded run for the tests of views."""

from pathlib import Path

import pytest

from marsarm.telemetry.recorder import Recorder, run_header
from marsarm.view.watched_run import WatchedRun, watch_log
from tests.marsarm.view.lab import ARM, COMMANDS, TILTED, records_of, start_loop


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a short run of an as-built arm on a tilted rover."""
    path = tmp_path_factory.mktemp("view") / "run.mcap"
    loop = start_loop(ARM, TILTED)
    header = run_header(loop, ARM.name, 0, {}, COMMANDS, world=TILTED)
    with Recorder(path, header) as recorder:
        for record in records_of(loop):
            recorder.write(record)
    return path


@pytest.fixture(scope="session")
def run(log: Path) -> WatchedRun:
    """Return the run as a view shows it."""
    return watch_log(log)

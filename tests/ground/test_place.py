"""The placement job where the machine fails it."""

import errno
from dataclasses import replace

import pytest

from fsw.dictionary.faults import StalledEarly
from fsw.dictionary.joints import Joint
from ground.place import place
from ground.place_request import PlaceRequest
from ground.telemetry.read import read_log
from ground.telemetry.record import Recorder
from sim.arms import arm_named
from sim.effects.joints import HardstopAngle
from sim.sequence import Outcome


@pytest.fixture
def disk_full_after(monkeypatch):
    """Let the recorder write some cycles and then find the disk full."""

    def limit(cycles):
        written = Recorder.write

        def write(self, record):
            if record.tick >= cycles:
                raise OSError(errno.ENOSPC, "No space left on device")
            written(self, record)

        monkeypatch.setattr(Recorder, "write", write)

    return limit


def test_an_arm_that_finds_no_hardstop_is_not_placed_and_its_log_is_said_not_to_be(tmp_path, monkeypatch):
    arm = arm_named("nominal")
    in_the_way = tuple(HardstopAngle(joint, 0.03) for joint in Joint)
    monkeypatch.setattr("ground.request.arm_named", lambda *_: replace(arm, effects=in_the_way))
    report = place(PlaceRequest(log=tmp_path / "run.mcap"), lambda done, total, what: None)
    assert report.result.outcome is Outcome.FAULTED
    assert any(isinstance(evr, StalledEarly) for _, evr in report.result.evrs)
    assert report.result.contact is None
    assert "not recorded (the arm was not initialised)" in report.kept.log_problem
    assert not list(tmp_path.iterdir())


def test_a_full_disk_does_not_stop_the_arm_and_is_told(tmp_path, disk_full_after):
    disk_full_after(cycles=640)
    log = tmp_path / "run.mcap"
    report = place(PlaceRequest(log=log), lambda done, total, what: None)
    assert report.result.outcome is Outcome.DONE
    assert report.kept.log_problem is not None
    assert "from 10.00 s on (No space left on device)" in report.kept.log_problem
    assert len(read_log(log)["/joint"]) == 640

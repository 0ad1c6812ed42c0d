"""The placement job where the machine fails it."""

import errno
from dataclasses import replace
from io import FileIO

from fsw.dictionary.faults import StalledEarly
from fsw.dictionary.joints import Joint
from ground.place import place
from ground.place_request import PlaceRequest
from ground.telemetry.read import read_log
from sim.arms import arm_named
from sim.effects.joints import HardstopAngle
from sim.sequence import Outcome


class SmallDisk(FileIO):
    """A file on a disk with room for 500 kB."""

    room = 500_000

    def write(self, data):
        if self.tell() + len(data) > self.room:
            super().write(data[: self.room - self.tell()])
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


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


def test_a_full_disk_does_not_stop_the_arm_and_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("ground.telemetry.opening.FileIO", SmallDisk)
    log = tmp_path / "run.mcap"
    report = place(PlaceRequest(log=log), lambda done, total, what: None)
    assert report.result.outcome is Outcome.DONE
    kept = read_log(log)
    ((time_s, event),) = report.kept.events
    assert kept.truncated
    assert len(kept["/joint"]) == round(64 * event.from_s) > 100
    assert event.from_s <= time_s < report.result.duration_s
    assert report.kept.log_problem == event.message
    assert f"not recorded from {event.from_s:.2f} s on (No space left on device)" in event.message

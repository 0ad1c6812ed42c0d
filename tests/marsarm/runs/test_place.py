"""Tests of placements with failures of the machine."""

from dataclasses import replace

from fsw.dictionary.enums import Joint
from fsw.dictionary.faults import StalledEarly
from marsarm.runs.place import place
from marsarm.runs.request import PlaceRequest, RunFiles
from sim.arms import arm_named
from sim.effects.joints import HardstopAngle
from sim.sequence import Outcome


def test_an_arm_that_finds_no_hardstop_is_not_placed_and_its_log_is_said_not_to_be(tmp_path, monkeypatch):
    arm = arm_named("nominal")
    in_the_way = tuple(HardstopAngle(joint, 0.03) for joint in Joint)
    monkeypatch.setattr("marsarm.common.requests.arm_named", lambda *_: replace(arm, effects=in_the_way))
    report = place(PlaceRequest(files=RunFiles(log=tmp_path / "run.mcap")))
    result = report.execution.result
    assert result.outcome is Outcome.FAULTED
    assert any(isinstance(evr, StalledEarly) for _, evr in result.evrs)
    assert result.contact is None
    assert "not recorded (the arm was not initialised)" in report.execution.artifacts.log_problem
    assert not list(tmp_path.iterdir())

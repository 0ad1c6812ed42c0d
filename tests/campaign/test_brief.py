"""Tests of the brief campaigns: each campaign has one, and failed and skipped campaigns are distinguished."""

import re
import sys
from pathlib import Path

import pytest

from validation.brief import BRIEFS, Brief, main, run

ROOT = Path(__file__).parents[2]
WHOLE = {
    "jobs": ("scenarios", "tool_change", "contact", "faults"),
    "blind": ("blind.brief",),
    "robot_cases": ("robot_cases.brief",),
    "joints": ("hardstops", "backlash", "shoulder_in"),
}
OTHERWISE = {"brief", "fuzz", "benchmarks", "cluster", "requirements", "robot_engine", "view"}
"""The list of brief campaigns itself, the fuzzer, which takes a minute, benchmarks of speed, the cluster,
which needs Ray, requirements, which are measured by other campaigns, and the view, which needs Chromium."""


def test_every_campaign_that_make_runs_has_a_brief_version() -> None:
    makefile = (ROOT / "Makefile").read_text()
    made = set(re.findall(r"-m validation\.(\w+)", makefile))
    wanted = {part for name in made - OTHERWISE for part in WHOLE.get(name, (name,))}
    assert {brief.name for brief in BRIEFS} >= wanted


def test_a_campaign_that_does_not_know_its_arguments_has_failed() -> None:
    ended = run(Brief("kinematics", "--targets none"))
    assert (ended.failed, ended.skipped) == (True, False)
    assert "invalid int value" in ended.stderr
    assert ended.line().startswith("kinematics   FAILED")


def test_a_campaign_that_lacks_what_it_needs_is_skipped_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MARSARM_DATA", raising=False)
    (ur10,) = (brief for brief in BRIEFS if brief.name == "ur10")
    ended = run(ur10)
    assert (ended.failed, ended.skipped) == (False, True)
    assert ended.line().endswith("needs MARSARM_DATA, a folder with the measured poses")


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "status"), [("--targets 19 --vectors 19", 0), ("--targets 0", 1)])
def test_the_exit_status_tells_whether_all_are_in_bounds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: str, status: int
) -> None:
    monkeypatch.setattr(sys, "argv", ["brief"])
    assert main([Brief("kinematics", f"{arguments} --workers 1")]) == status
    assert len(capsys.readouterr().out.splitlines()) == 1

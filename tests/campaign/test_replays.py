"""Tests of the campaign of replays with runs that cannot be replayed."""

import json
import sys

import pytest

from simgap.common.errors import BadRequest
from validation import replays


def refused(*_: object) -> None:
    raise BadRequest("no such arm")


def same(scenario: str, arm: str) -> replays.ReplayOutcome:
    return replays.ReplayOutcome(scenario, arm, "done", "identical", True, 10, 100, 1.0, 1.0)


def test_a_run_that_is_refused_is_counted_as_not_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replays, "run_scenario", refused)
    one = replays.replay_one("contact", "nominal")
    assert (one.outcome, one.verdict, one.identical) == (replays.NOT_REPLAYED, "no such arm", False)
    found = replays.summarize([same("press", "nominal"), one])
    assert (found["requested"], found["replayed"], found["identical"]) == (2, 1, 1)


@pytest.mark.parametrize(("outcome", "status"), [("done", 0), (replays.NOT_REPLAYED, 1)])
def test_the_exit_status_tells_whether_all_that_was_asked_is_the_same(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], outcome: str, status: int
) -> None:
    lone = replays.ReplayOutcome("contact", "nominal", outcome, "", outcome == "done", 10, 100, 1.0, 1.0)
    monkeypatch.setattr(replays, "document", lambda *_: replays.summarize([lone]))
    monkeypatch.setattr(sys, "argv", ["replays"])
    with pytest.raises(SystemExit) as ended:
        replays.main()
    assert ended.value.code == status
    assert json.loads(capsys.readouterr().out)["requested"] == 1

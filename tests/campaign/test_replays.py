"""Tests of the campaign of replays with runs that cannot be replayed."""

import pytest

from simgap.common.errors import BadRequest
from validation import scenarios
from validation.campaigns import Context


def refused(*_: object) -> None:
    raise BadRequest("no such arm")


def test_a_run_that_is_refused_is_counted_as_not_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "run_scenario", refused)
    one = scenarios.replay_one("contact", "nominal")
    assert (one.outcome, one.verdict, one.identical) == (scenarios.NOT_REPLAYED, "no such arm", False)
    same = scenarios.ReplayOutcome("press", "nominal", "done", "identical", True, 10)
    found = scenarios.summarize([same, one])
    assert (found["requested"], found["replayed"], found["identical"]) == (2, 1, 1)
    assert (found["in_bounds"], scenarios.summarize([same])["in_bounds"]) == (False, True)


def test_a_scenario_that_is_none_is_refused() -> None:
    with pytest.raises(BadRequest, match=r"set only: there are .*tool-change"):
        scenarios.replays(Context(), only="dance")

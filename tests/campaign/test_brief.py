"""Tests of the command of all campaigns, and of their brief form."""

import json

import pytest

from validation.__main__ import main
from validation.campaigns import TABLE, BriefResult, Campaign, Context, read_sizes

WITHOUT_A_BRIEF_FORM = {
    *("benchmarks", "brief", "documents", "mutants", "so101", "step-pairs", "view"),
    *("next-cases", "robot-pairs"),
}
"""Measurements of speed, lists of other campaigns, what needs optional programs, and diagnoses in pairs."""


def test_every_campaign_has_a_brief_form_or_a_reason():
    assert {one.name for one in TABLE if one.brief is None} == WITHOUT_A_BRIEF_FORM


@pytest.mark.parametrize("one", TABLE, ids=lambda one: one.name)
def test_a_campaign_knows_its_sizes(one):
    sizes = {name: str(value) for name, value in (one.brief or {}).items()}
    work = one.load()
    if one.name != "so101":  # it has to be told its files
        assert read_sizes(work, (f"{name}={value}" for name, value in sizes.items())).keys() == sizes.keys()


def test_campaigns_are_listed(capsys):
    assert main([]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(TABLE)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dance"], "dance: is no campaign; `python -m validation` lists them"),
        (["hardstops", "--set", "speed=3"], "set speed: is not known; there are arms, repeats, joint"),
        (["hardstops", "--set", "arms=none"], "set arms: 'none' is not int"),
        (["hardstops", "--set", "arms=-1"], "set arms: -1 is below 0"),
        (["calibration", "--set", "closed_loop=2"], "set closed_loop: '2' is not bool"),
        (["so101"], "set logs: is missing"),
        (["hardstops", "--set", "joint=KNEE"], "the joint is a name like ELBOW"),
    ],
)
def test_what_cannot_be_run_is_said(words, said, capsys):
    assert main(words) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(("in_bounds", "status"), [(True, 0), (False, 1)])
def test_the_exit_status_tells_whether_a_campaign_is_in_bounds(
    in_bounds, status, tmp_path, capsys, monkeypatch
):
    document = {"rate": 0.123456, "rows": [1, 2], "part": {"n": 3}, "in_bounds": in_bounds}
    monkeypatch.setattr(Campaign, "load", lambda _: lambda context: document)
    assert main(["hardstops", "--json", "--out", str(tmp_path / "found.json")]) == status
    printed, written = capsys.readouterr().out, (tmp_path / "found.json").read_text()
    assert json.loads(printed) == json.loads(written) == document
    assert main(["hardstops"]) == status
    assert capsys.readouterr().out.splitlines() == ["rate: 0.1235", "part / n: 3", f"in_bounds: {in_bounds}"]


@pytest.mark.parametrize(("status", "verdict"), [(0, "in bounds"), (2, "FAILED, exit status 2")])
def test_the_line_of_a_campaign_in_brief_says_how_it_ended(status, verdict):
    assert BriefResult(TABLE[0], status, 3.0, "").line().endswith(f"  3 s, {verdict}")


def test_jobs_come_back_in_their_order_and_progress_is_told():
    told: list[tuple[float, float, str]] = []
    backwards = Context(run=lambda work, jobs: map(work, reversed(jobs)), progress=lambda *x: told.append(x))
    assert backwards.each(pow, ((2, 3), (3, 2)), "powers") == [8, 9]
    assert told == [(0, 2, "powers"), (1, 2, "powers"), (2, 2, "powers")]

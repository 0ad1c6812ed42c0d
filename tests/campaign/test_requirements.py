"""The page of requirements: its tests exist, its bounds are those of the code, its numbers those of today."""

import json
from dataclasses import replace

import pytest

from helpers.marks import slow_but
from validation import requirements

TABLE = requirements.load_table()
KEPT = json.loads(requirements.MEASURED.read_text())
SHORT = ("budget", "mars")
"""Campaigns of some seconds."""
SAME = 1e-3
"""Largest relative change of a number that counts as the same: another processor rounds otherwise."""
NOT_MET = {row.name for row in TABLE.rows if row.paper is not None and row.margin(row.paper) < 0}
"""Requirements that the paper's own budget does not meet."""


def test_every_requirement_is_met_but_for_those_that_the_paper_does_not_meet():
    values = {name: value for kept in KEPT.values() for name, value in kept["values"].items()}
    assert {row.name for row in TABLE.rows if row.margin(values[row.name]) < 0} == NOT_MET
    assert len(NOT_MET) == 3


def test_every_subject_of_the_paper_has_a_requirement():
    names = " ".join(row.name.lower() for row in TABLE.rows)
    for subject in (
        "total position accuracy", "relative tool change", "preload", "tilted by 30 deg", "tilted by 20 deg",
        "workspace", "hardstop", "calibration", "verification", "processing", "delivery", "bit exchange",
    ):  # fmt: skip
        assert subject in names


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_but(SHORT))
def test_a_short_campaign_measures_the_numbers_of_the_page(name):
    campaign = next(one for one in TABLE.campaigns if one.name == name)
    assert requirements.measure(TABLE, campaign) == pytest.approx(KEPT[name]["values"], rel=SAME)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"tests": ("tests/campaign/test_brief.py::test_of_nothing",)}, "there is no test .*test_of_nothing"),
        ({"tests": ("tests/none.py",)}, "there is no test tests/none.py"),
        ({"tests": ()}, "no test shows it"),
        ({"campaign": "none"}, "no campaign is called none"),
        ({"name": "new"}, "new: was not measured"),
        ({"most": 9.0, "constant": "validation/tool_change.py:FROM_SPOT_MM"}, "the bound is 9.0 mm, but"),
        ({"constant": "sim/scenario/data.py:Placed.lateral_m"}, "is 20.0 mm, but .*lateral_m is 0.015"),
        ({"constant": "sim/scenario/data.py:Placed.nothing"}, "is 20.0 mm, but .*nothing is None"),
    ],
)
def test_a_wrong_row_is_named(change, sentence):
    row = replace(TABLE.rows[0], **change)
    (problem,) = requirements.find_problems(replace(TABLE, rows=(row,)), KEPT)
    with pytest.raises(AssertionError, match=sentence):
        raise AssertionError(problem)


def test_a_number_of_another_command_is_named():
    other = {"reach": {**KEPT["reach"], "command": "python -m marsarm reach"}}
    (problem,) = requirements.find_problems(replace(TABLE, rows=()), other)
    assert problem.startswith("campaign reach: was measured by another command")


def test_the_worst_value_counts_and_the_margin_is_what_is_left_of_the_bound():
    document = {"a": [{"x": 1.0}, {"x": 3.0}], "b": [{"x": 2.0}]}
    most = requirements.RequirementRow("", "", "mm", "", ("*", "*", "x"), (), most=6.0)
    least = replace(most, most=None, least=0.5)
    assert sorted(requirements.select(document, most.value)) == [1.0, 2.0, 3.0]
    assert most.measure(document) == 3.0
    assert most.margin(3.0) == 0.5
    assert least.measure(document) == 1.0
    assert least.margin(1.0) == 1.0
    assert most.margin(9.0) == -0.5
    assert least.margin(0.25) == -0.5


def test_the_number_of_a_changed_tree_is_marked():
    kept = {name: {**campaign, "commit": 40 * "a" + "-dirty"} for name, campaign in KEPT.items()}
    assert requirements.make_page(TABLE, kept).count("`aaaaaaa-dirty`") == len(TABLE.campaigns)

"""`marsarm budget`: the paper's rows beside ours; errors are named and nothing is written."""

import json
from dataclasses import replace

import numpy as np
import pytest

from marsarm.accuracy.budget import TABLE_3, TABLE_4, BudgetReport, run_budget
from marsarm.accuracy.budget_report import budget_document, budget_page, budget_requirements
from marsarm.accuracy.request import BudgetRequest
from simgap.common.report import save_report_page, to_json
from tests.marsarm.command import marsarm


@pytest.fixture(scope="module")
def report() -> BudgetReport:
    return run_budget(BudgetRequest(poses=1500))


def test_every_row_of_the_papers_tables_is_there(report):
    assert [row for row, _ in report.rows] == [*TABLE_3, *TABLE_4]


def test_before_calibration_the_arm_misses_what_is_required_and_after_it_does_not(report):
    missed = {row for row, value in report.rows if value > row.required}
    assert missed == {row for row, _ in report.rows if row.estimated > row.required}


def test_positions_come_within_a_fourth_of_the_papers_and_repeatability_within_a_tenth(report):
    ratios = {row: value / row.estimated for row, value in report.rows if row.component != "axial_rad"}
    assert all(0.85 < ratio < 1.25 for ratio in ratios.values())
    assert all(0.9 < ratio < 1.1 for row, ratio in ratios.items() if "repeatability" in row.name)


def test_rover_stiffness_and_zero_offset_are_the_largest_sources_beside_heat_and_backlash(report):
    budget = report.budgets["accuracy"]
    order = np.argsort(-budget.share_m.sum(axis=1))
    ranked = [list(budget.case.sources)[k] for k in order]
    others = [name for name in ranked if name != "backlash" and not name.startswith("distortion")]
    assert set(others[:2]) == {"rover_stiffness", "zero_offset"}


def test_the_document_holds_shares_that_add_up_to_the_mean_total(report):
    for name, case in to_json(budget_document(report))["cases"].items():
        total = sum(sum(frames.values()) for frames in case["share_m"].values())
        by_tool = [tool.by_rule["paper"].total_m for tool in report.budgets[name].tools.values()]
        assert total == pytest.approx(np.concatenate(by_tool).mean())


def test_the_page_is_one_file_with_its_pictures_in_it(report, tmp_path):
    page = tmp_path / "budget.html"
    rows = tuple((row, value) for row, value in report.rows if row.case == "accuracy")
    report = replace(report, budgets={"accuracy": report.budgets["accuracy"]}, rows=rows)
    save_report_page(budget_page(report), page)
    text = page.read_text()
    assert text.count("<svg ") == 2
    met = sum(value <= row.required for row, value in report.rows)
    assert f"Fail: {len(report.rows) - met} of {len(report.rows)} requirements are not met." in text


def test_few_poses_show_nothing(tmp_path):
    page = tmp_path / "budget.html"
    report = run_budget(BudgetRequest(case="mars", tool="apxs", poses=1000))
    save_report_page(budget_page(report), page)
    assert "Not shown: 0 of 3 requirements are met, 3 are not shown." in page.read_text()
    assert "1000 of 1365 poses" in page.read_text()


@pytest.fixture(scope="module")
def mars() -> BudgetReport:
    return run_budget(BudgetRequest(case="mars", tool="apxs", poses=2000))


@pytest.mark.parametrize(
    ("times", "passed"), [(1.5, True), (1.001, None), (0.999, None), (0.5, False)], ids=str
)
def test_a_bound_within_the_interval_of_the_estimate_is_not_shown(mars, times, passed):
    rows = tuple((replace(row, required=times * value), value) for row, value in mars.rows)
    assert [row.passed for row in budget_requirements(replace(mars, rows=rows))] == [passed] * 3


def test_the_command_prints_one_document_and_writes_a_page_and_a_picture(tmp_path):
    words = ("budget", "--case", "accuracy", "--tool", "apxs", "--poses", "300", "--json")
    done = marsarm(tmp_path, *words, "--report", "page.html", "--picture", "rows.png")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["cases"]["accuracy"]["tools"] == ["apxs"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.html", "rows.png"]

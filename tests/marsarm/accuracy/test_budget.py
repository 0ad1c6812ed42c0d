"""The error budget: its sources, its rules, its rows, its command, and its sensitivities."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fsw.config import configure
from fsw.kinematics.arm import Arm, heat_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, rotate_back
from marsarm.accuracy import propagation
from marsarm.accuracy.budget import TABLE_3, TABLE_4, BudgetReport, run_budget
from marsarm.accuracy.budget_report import budget_document, budget_page, budget_requirements
from marsarm.accuracy.request import BudgetRequest
from sim.arms import nominal_params
from simgap.common.report import save_report_page, to_json
from tests.marsarm.command import marsarm_json


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
        by_tool = [tool.by_rule["paper"]["total_m"] for tool in report.budgets[name].tools.values()]
        assert total == pytest.approx(np.concatenate(by_tool).mean())


@pytest.mark.slow
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


def test_the_command_prints_one_document_and_writes_a_page(tmp_path):
    words = ("budget", "--case", "accuracy", "--tool", "apxs", "--poses", "300")
    document = marsarm_json(tmp_path, *words, "--report", "page.html")
    assert document["cases"]["accuracy"]["tools"] == ["apxs"]
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


ERRORS = arrays(np.float64, (4, 6, 7, 2), elements=st.floats(0.0, 1e-2))
AT_LIMIT = np.array([True, False, True, False])


@settings(max_examples=50, deadline=None)
@given(ERRORS)
def test_the_paper_rule_lies_between_the_best_and_the_worst_case(u):
    assert np.all(propagation.root_sum_square(u) <= propagation.paper_rule(u, AT_LIMIT) + 1e-15)
    assert np.all(propagation.paper_rule(u, AT_LIMIT) <= propagation.worst_case(u) + 1e-15)


def test_the_paper_rule_adds_frames_then_roots_sources_then_adds_those_at_their_limits():
    u = np.zeros((4, 6, 7, 1))
    u[0, 3, :2] = [[1.0], [2.0]]
    u[1, 3, 0], u[2, 3, 0], u[3, 3, 0] = 3.0, 5.0, 4.0
    assert propagation.paper_rule(u, AT_LIMIT)[3, 0] == pytest.approx(1 + 2 + 5 + np.hypot(3, 4))


def test_lateral_is_across_the_approach_and_normal_along_it():
    found = propagation.bounds(np.array([[9.0], [0.3], [0.4], [2.0], [3.0], [4.0]]))
    assert (found["normal_m"][0], found["lateral_m"][0]) == (2.0, 5.0)
    assert found["total_m"][0] == pytest.approx(np.sqrt(29))
    assert found["axial_rad"][0] == 0.5


def test_ours_is_never_more_than_the_worst_case():
    u = np.zeros((3, 1, 1))
    u[0] = 2.0
    length = propagation.squared_length([(u, "uniform")])
    worst = dict.fromkeys(propagation.PARTS, np.array([2.0]))
    assert length.quantile(0.9973)[0] > 2.0
    lengths = dict.fromkeys(propagation.PARTS, length)
    assert propagation.moments_rule(lengths, worst, 0.9973)["total_m"].tolist() == [2.0]


MODEL = propagation.load_error_model()
TABLE_2 = {
    "assembly": "systematic",
    "backlash": "random",
    "deflection": "systematic",
    "distortion_bulk": "systematic",
    "distortion_gradient": "systematic",
    "encoder": "random",
    "slop": "random",
    "windup": "random",
    "wobble": "random",
    "zero_offset": "random",
}
NOT_ON_THE_SAME_DAY = {"assembly", "backlash", "deflection", "windup", "zero_offset"}


def test_cases_have_the_sources_of_the_papers_tables_and_the_rover_which_the_text_tells_apart():
    before, again, mars = (set(MODEL.case[name].sources) for name in ("accuracy", "repeatability", "mars"))
    kinds = {name: MODEL.source[name].kind for name in before}
    assert kinds == {**TABLE_2, "rover_stiffness": "systematic"}
    assert again == set(TABLE_2) - NOT_ON_THE_SAME_DAY
    assert MODEL.case["repeatability"].sources["distortion_bulk"] < 1
    assert {"tool_orientation", "isolator_hysteresis", "motor_controller"} <= mars - before


def test_backlash_deflection_and_bulk_distortion_lie_at_their_limits():
    at_limit = {name for name, source in MODEL.source.items() if source.at_limit}
    assert at_limit == {"backlash", "deflection", "rover_stiffness", "distortion_bulk"}


@pytest.mark.parametrize("name", MODEL.source)
def test_a_source_has_a_magnitude_a_basis_and_a_spread(name):
    source = MODEL.source[name]
    assert (source.theta.any()) == (source.relative_to == "frames")
    assert (source.share > 0) == (source.relative_to != "frames")
    assert source.basis
    assert source.text
    assert propagation.CUMULANTS[source.distribution][0] > 0


CONFIG = configure(nominal_params())
ARM = CONFIG.arm
MARS = np.array([0.0, 0.0, 3.711])
SMALL = 1e-4


@pytest.fixture(scope="module")
def poses() -> propagation.Poses:
    return propagation.workspace_poses(ARM, "mahli", MARS, 60, 3)


@pytest.fixture(scope="module")
def sensitivity(poses: propagation.Poses) -> propagation.Sensitivity:
    return propagation.compute_sensitivity(CONFIG, poses, MARS)


def shift(before: Arm, after: Arm, poses: propagation.Poses, output_rad: Array) -> Array:
    """Compute the shift of the tool in tool axes, shape (3, n).

    The motors stand where they put `before` at the poses.
    """
    here = tool_pose(before, settle_output(before, poses.output_rad, MARS).frames, poses.tool)
    there = tool_pose(after, settle_output(after, output_rad, MARS).frames, poses.tool)
    return rotate_back(here.R, there.p - here.p)


def test_poses_are_as_many_as_asked_for_and_put_the_tool_on_its_target(poses):
    assert poses.output_rad.shape == (5, 60)
    p_R = tool_pose(ARM, settle_output(ARM, poses.output_rad, MARS).frames, poses.tool).p
    assert np.allclose(p_R - poses.p_NoTo_N_m, (p_R - poses.p_NoTo_N_m)[:, :1], atol=1e-6)


def test_a_softer_arm_sags_by_its_share_more(poses, sensitivity):
    softer = replace(
        ARM,
        compliance=ARM.compliance * (1 + SMALL),
        gear_stiffness_Nm_rad=ARM.gear_stiffness_Nm_rad / (1 + SMALL),
    )
    torque = settle_output(ARM, poses.output_rad, MARS).torque_Nm
    wound = poses.output_rad + SMALL * torque / ARM.gear_stiffness_Nm_rad[:, None]
    expected = SMALL * sensitivity.deflection.sum(axis=1)[3:]
    # the load changes with the deflection, which the paper's equation 9 neglects
    assert np.abs(shift(ARM, softer, poses, wound) - expected).max() < 0.06 * np.abs(expected).max()


def test_a_warmer_arm_grows(poses, sensitivity):
    rigid = np.zeros((6, 6, 60))
    before = tool_pose(ARM, forward(ARM, poses.output_rad, rigid), poses.tool)
    warm = heat_arm(ARM, 1.0)
    after = tool_pose(warm, forward(warm, poses.output_rad, rigid), poses.tool)
    grown = sensitivity.expansion_1_K.sum(axis=1)[3:]
    # the deflected arm differs from the rigid one by a few milliradians
    assert np.allclose(rotate_back(before.R, after.p - before.p), grown, atol=2e-2 * np.abs(grown).max())


def test_absolute_components_bound_every_draw(sensitivity):
    rng = np.random.default_rng(0)
    source = MODEL.source["assembly"]
    bound = sensitivity.errors_by_frame(source).sum(axis=1)
    u = sensitivity.errors(source)
    for _ in range(50):
        draw = np.einsum("ikn,k->in", u, rng.uniform(-1.0, 1.0, u.shape[1]))
        assert np.all(np.abs(draw) <= bound)

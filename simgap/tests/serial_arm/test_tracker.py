"""Diagnosis of an arm by tracker poses: what was built in is named with its size, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.marks import slow_but
from helpers.real_robots import repository_file
from helpers.serial_synthetic import POSITION_M, built_arm, drawn_arm, series, setup
from simgap.common.errors import RobotError
from simgap.serial_arm import effects as kinds
from simgap.serial_arm.calibrate import calibrate_series, estimate_setup, pose_errors
from simgap.serial_arm.files import read_arm, read_series
from simgap.serial_arm.model import TERMS
from simgap.serial_arm.tracker import diagnose_tracker, fit_tracker

COUNT = 500
WAVES = (0.0, 3e-4, 0.0, 0.0, 0.0, 0.0)
FLAT = (0.0,) * 6
THREE = {
    "joint0": {"hysteresis_rad": 2e-4},
    "joint1": {"compliance_rad_per_Nm": 4e-5},
    "joint2": {"sin_rad": WAVES},
}


def built_with(**effects):
    """Return an arm whose links have errors, and whose joints have only these effects."""
    arm = built_arm(drawn_arm(3), 4)
    none = {"compliance_rad_per_Nm": 0.0, "hysteresis_rad": 0.0, "cos_rad": FLAT, "sin_rad": FLAT}
    return replace(arm, links=tuple(replace(one, **none | effects.get(one.name, {})) for one in arm.links))


def diagnose(arm, count=COUNT, seed=5):
    """Diagnose simulated poses of an arm."""
    return diagnose_tracker(drawn_arm(3), series(arm, setup(2), count, seed))


@pytest.fixture(scope="module")
def three():
    """Diagnose an arm with one effect at each joint."""
    return diagnose(built_with(**THREE))


def test_each_effect_is_named_at_its_joint_with_its_size_and_no_other_without_a_reason(three):
    sizes = {(one.place, one.effect): (one.size[0], one.interval[0]) for one in three.findings}
    truth = {("joint0", kinds.DirectionHysteresis.name): 2e-4, ("joint1", kinds.TrackerCompliance.name): 4e-5}
    truth["joint2", kinds.PeriodicJointError.name] = 3e-4 / np.sqrt(2)
    assert sizes.keys() == truth.keys()
    for name, (size, (low, high)) in sizes.items():
        assert size == pytest.approx(truth[name], rel=0.15)
        assert low - 0.3 * (high - low) < truth[name] < high + 0.3 * (high - low)
    assert all(0.0 < one.share < 1.0 for one in three.findings)  # of the error comes back without it
    rejected = {(one.place, one.effect): one.reason for one in three.rejected}
    assert len(rejected) == 3 * 3 - 3
    assert all(rejected.values())


def test_the_findings_explain_held_out_poses_to_the_noise(three):
    position = three.errors[0]
    assert position.nominal > position.base > position.explained
    assert position.explained < 1.2 * np.sqrt(3) * POSITION_M


def test_the_patched_arm_predicts_as_the_diagnosis_says(three):
    arm = kinds.patch_arm(drawn_arm(3), three.effects, three.sizes)
    poses = series(built_with(**THREE), setup(2), COUNT, 5)
    part, fresh = poses.at(np.arange(COUNT) < COUNT // 2), poses.at(np.arange(COUNT) >= COUNT // 2)
    placed = calibrate_series(arm, estimate_setup(arm, part), part, ())
    error = pose_errors(placed.arm, placed.setup, fresh)
    assert error.rms_m == pytest.approx(three.errors[0].explained, rel=0.02)


@pytest.mark.parametrize("seed", slow_but(range(4), 0))
def test_an_arm_with_errors_of_its_links_only_has_no_finding(seed):
    found = diagnose(built_with(), 200, seed)
    assert found.findings == found.remaining == ()
    assert found.errors[0].explained < 1.3 * np.sqrt(3) * POSITION_M


def test_a_compliance_below_zero_is_not_named():
    found = diagnose(built_with(joint1={"compliance_rad_per_Nm": -4e-5}))
    assert all(one.effect != kinds.TrackerCompliance.name for one in found.findings)
    reasons = {(one.place, one.effect): one.reason for one in found.rejected}
    reason = reasons["joint1", kinds.TrackerCompliance.name]
    assert "no joint is" in reason or "does not lower" in reason


def test_a_temperature_that_moves_nothing_is_rejected_with_its_numbers():
    air = 22 + np.sin(np.linspace(0, 9, 200))
    poses = series(built_with(), setup(2), 200, 3, air=air)
    found = diagnose_tracker(drawn_arm(3), poses)
    assert any(one.effect == "air temperature" and "falls by" in one.reason for one in found.rejected)
    assert "temperature" not in {one.depends_on for one in found.remaining}


def test_a_base_that_moves_with_the_temperature_is_what_remains():
    air = 22 + np.sin(np.linspace(0, 30, 400)) + 0.3 * np.sin(np.linspace(0, 170, 400))
    poses = series(built_with(), setup(2), 400, 3, air=air)
    p = poses.X_TM.p + np.array([[0.0], [0.0], [3 * POSITION_M]]) * (air - 22)
    found = diagnose_tracker(drawn_arm(3), replace(poses, X_TM=replace(poses.X_TM, p=p)))
    assert found.remaining[0].depends_on == "temperature"
    assert found.remaining[0].depends_share > 0.2


def test_the_zero_of_the_first_joint_is_not_identifiable(three):
    base = {(one.place, one.name): one for one in three.base}
    assert not base["joint0", "theta_rad"].is_identifiable
    assert base["joint1", "alpha_rad"].is_identifiable


def test_few_poses_are_refused():
    with pytest.raises(RobotError, match="10 poses to fit and 10 to judge are too few"):
        diagnose(built_with(), 20)


def test_without_a_parameter_the_fit_is_that_of_a_model_without_it():
    drawn = drawn_arm(3)
    part = series(built_with(joint1={"compliance_rad_per_Nm": 2e-5}), setup(2), 200, 6)
    stands = estimate_setup(drawn, part)
    fit = calibrate_series(drawn, stands, part, TERMS).fit
    terms = tuple(term for term in TERMS if term != "compliance")
    other = calibrate_series(drawn, stands, part, terms).fit
    is_out = np.array([one.name.endswith(".compliance") for one in fit.parameters])
    found = kinds.Elimination(fit).without(is_out)
    assert found.by_block.shape == (kinds.BLOCKS, fit.values.size)
    assert np.all(found.values[is_out] == 0.0)
    near = np.abs(found.values[~is_out] - other.values) / np.array([one.scale for one in other.parameters])
    assert near.max() < 0.01


@pytest.mark.real_data
@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "mapping", "held_out_mm"),
    [("series_a_grid.csv", "series_a.toml", 0.12), ("series_c_random_poses.csv", "series_c.toml", 0.10)],
)
def test_the_joints_have_the_effects_that_the_calibration_shows(real_data, table, mapping, held_out_mm):
    arm = read_arm(repository_file("models/robots/ur10/arm.toml"))
    path = repository_file(f"models/robots/ur10/{mapping}")
    series = read_series(arm, real_data / "ur10-tracker" / table, path)
    found = diagnose_tracker(arm, series)
    named = {(one.effect, one.place) for one in found.findings}
    periodic = {place for effect, place in named if effect == "periodic joint error"}
    assert periodic == {one.name for one in arm.links}
    assert {place for effect, place in named if effect == "joint compliance"} == {"shoulder_lift", "elbow"}
    assert ("direction hysteresis", "shoulder_pan") in named
    assert found.errors[0].explained * 1e3 < held_out_mm
    assert "air temperature" in {one.effect for one in found.rejected}
    assert "temperature" not in {one.depends_on for one in found.remaining}


@pytest.mark.real_data
@pytest.mark.slow
def test_the_arm_of_one_series_is_that_of_a_series_four_months_later(real_data):
    folder, models = real_data / "ur10-tracker", "models/robots/ur10"
    arm = read_arm(repository_file(f"{models}/arm.toml"))
    named = (("series_a_grid.csv", "series_a.toml"), ("series_c_random_poses.csv", "series_c.toml"))
    paths = ((folder / table, repository_file(f"{models}/{mapping}")) for table, mapping in named)
    one, other = (read_series(arm, *both) for both in paths)
    moved = fit_tracker(fit_tracker(arm, one).found.arm, other, terms=())
    assert moved.models[-1].fresh.rms_m < 0.60e-3

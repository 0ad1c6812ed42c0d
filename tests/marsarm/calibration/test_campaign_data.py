"""Campaign data, and a campaign in the closed loop, whose measurements show the true arm."""

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from fsw.kinematics.transforms import Pose, inverse
from marsarm.calibration.calibrate import data_sha256
from marsarm.calibration.campaign import (
    PAPER_GROUPS,
    CampaignPlan,
    earth_reference,
    resize_groups,
    run_campaign,
)
from marsarm.calibration.campaign_data import BadData, MeasuredPoses, read_campaign, save_campaign
from marsarm.calibration.execution import check_data
from marsarm.calibration.residual_model import whiten_joint_jacobian
from marsarm.calibration.verify import simulate_campaign, true_poses, zero_errors_rad
from sim.arm_check import NoPlan
from sim.arms import arm_named
from sim.frames import P_NR_M
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from simgap.serial_arm.chain import error_screw
from tests.marsarm.calibration.lab import NOMINAL, campaign

RNG = np.random.default_rng(0)


def test_whitened_noise_has_variance_one():
    n = 20_000
    root = RNG.standard_normal((6, 6))
    measured = MeasuredPoses(Pose(np.zeros((3, 3, n)), np.zeros((3, n))), np.tile(root @ root.T, (n, 1, 1)))
    W, _ = whiten_joint_jacobian(measured, np.zeros((6, n, 5)))
    noise = np.einsum("nij,jk,nk->ni", W, root, RNG.standard_normal((n, 6)))
    np.testing.assert_allclose(np.cov(noise.T), np.eye(6), atol=0.05)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_table_is_read_as_it_was_written(tmp_path, suffix):
    path = tmp_path / f"poses{suffix}"
    save_campaign(campaign(), path)
    read = read_campaign(path)
    assert data_sha256(read) == data_sha256(campaign())
    assert read.branch == campaign().branch
    covariance = campaign().measured.covariance
    np.testing.assert_allclose(read.measured.covariance, covariance, rtol=0, atol=1e-12 * covariance.max())


def table(tmp_path, change):
    path = tmp_path / "poses.parquet"
    save_campaign(campaign(), path)
    parquet.write_table(change(parquet.read_table(path)), path)
    return path


def test_a_missing_column_is_named(tmp_path):
    path = table(tmp_path, lambda t: t.drop_columns(["motor_elbow_rad", "cov_35"]))
    with pytest.raises(BadData, match="columns missing: motor_elbow_rad, cov_35"):
        read_campaign(path)


def test_a_column_of_texts_and_one_with_gaps_are_named(tmp_path):
    def damaged(t):
        t = t.set_column(t.column_names.index("p_x_m"), "p_x_m", pa.array(["one"] * t.num_rows))
        holes = [None, *t["p_y_m"].to_pylist()[1:]]
        return t.set_column(t.column_names.index("p_y_m"), "p_y_m", pa.array(holes))

    with pytest.raises(BadData, match=r"'p_x_m' has 'one'.*\n.*p_y_m: no number in 1 rows, the first is 0"):
        read_campaign(table(tmp_path, damaged))


def with_poses(X: Pose):
    return replace(campaign(), measured=MeasuredPoses(X, campaign().measured.covariance))


def seen_once(row, pose, count):
    changed = campaign().targets_seen.copy()
    changed[row, pose] = count
    return replace(campaign(), targets_seen=changed)


def believing(**change):
    """Return the campaign with other values of what flight software believed, each made from the old."""
    believed = campaign().believed
    return replace(
        campaign(), believed=replace(believed, **{k: of(getattr(believed, k)) for k, of in change.items()})
    )


def posed(change):
    return with_poses(change(campaign().measured.X_RT))


def with_covariance(factor):
    measured = campaign().measured
    return replace(campaign(), measured=MeasuredPoses(measured.X_RT, factor * measured.covariance))


BAD = {
    "few": (lambda: campaign().at(np.arange(10)), "10 are too few; 24 at least"),
    "alike": (lambda: believing(motor_rad=lambda q: q[:, :1] + 0.01 * q), "joint elbow: moves over"),
    "degrees": (lambda: believing(motor_rad=np.degrees), "give radians"),
    "millimetres": (lambda: posed(lambda X: Pose(X.R, 1e3 * X.p)), "give metres"),
    "gravity in g": (lambda: believing(gravity_R_m_s2=lambda g: g / 98.1), "give m/s2"),
    "covariance in mm2": (lambda: with_covariance(1e6), "rad2, rad m, m2"),
    "missing marker": (lambda: seen_once(2, 7, 2), "targets_turret: pose 7"),
    "lock lost": (
        lambda: replace(campaign(), tracker_moved_m=np.where(np.arange(160) > 99, 0.01, 0.0)),
        "the tracker lost its lock or was moved",
    ),
    "another target": (
        lambda: replace(campaign(), misfit_m=np.where(np.arange(160) == 5, 2e-3, 4e-5)),
        "misfit_m: pose 5",
    ),
    "grams": (lambda: believing(turret_kg=lambda m: 1e3 * m), "give kilograms"),
    "endless turret": (
        lambda: believing(turret_kg=lambda m: np.where(np.arange(160) < 3, np.inf, m)),
        "turret_kg: 8 .. inf",
    ),
    "no side": (lambda: believing(side=lambda side: 0.5 * side), "is not a side; give"),
    "millinewton metres": (lambda: believing(friction_Nm=lambda torque: 1e3 * torque), "newton metres"),
    "copied rows": (lambda: campaign().at(np.tile(np.arange(40), 4)), r"poses 40, 41, .* copied rows"),
    "swapped": (lambda: posed(inverse), "The frames are swapped"),
    "rnav": (lambda: posed(lambda X: Pose(X.R, X.p + P_NR_M[:, None])), "Positions are in RNAV"),
    "quaternion": (lambda: posed(lambda X: Pose(X.R.swapaxes(0, 1), X.p)), "Quaternions are conjugated"),
    "one row off": (lambda: posed(lambda X: Pose(np.roll(X.R, 1, 2), np.roll(X.p, 1, 1))), "one row too low"),
}


@pytest.mark.parametrize("case", BAD)
def test_data_that_are_not_what_they_say_are_named(case):
    data, words = BAD[case]
    with pytest.raises(BadData, match=words):
        check_data(NOMINAL, data())


@pytest.mark.parametrize(
    ("stale", "noise_m", "words"),
    [
        (slice(50, 55), 1e-5, r"poses 5[0-4], .* the tracker lost its lock"),
        (slice(50, 51), 0.0, r"p_.*: pose 50 equal to the pose before"),
    ],
)
def test_poses_measured_while_the_lock_was_lost_are_named(stale, noise_m, words):
    X = campaign().measured.X_RT
    p = X.p.copy()
    p[:, stale] = p[:, 49:50] + noise_m * np.random.default_rng(0).standard_normal(p[:, stale].shape)
    with pytest.raises(BadData, match=words):
        check_data(NOMINAL, with_poses(Pose(X.R, p)))


def test_an_arm_without_a_name_is_refused(tmp_path):
    path = tmp_path / "poses.csv"
    save_campaign(replace(campaign(), arm_name=""), path)
    with pytest.raises(BadData, match="column arm: is empty"):
        read_campaign(path)


@pytest.mark.slow
def test_the_papers_campaign_is_planned():
    groups = [(group.turret_kg, round(np.degrees(group.roll_rad)), group.count) for group in PAPER_GROUPS]
    assert groups == [(8.0, 0, 40), (19.0, 0, 40), (8.0, 20, 40), (19.0, 20, 40)]
    inside = sum(branch.startswith("shoulder-in") for branch in campaign().branch)
    assert inside == pytest.approx(0.3 * 160, abs=2)


def test_an_arm_whose_loads_on_earth_cannot_be_those_on_mars_is_refused(monkeypatch):
    def find_no_plan(arm, on_earth):
        raise NoPlan("the best torques differ from the wanted ones by [9.0] N m")

    monkeypatch.setattr("marsarm.calibration.campaign.without_turret", find_no_plan)
    with pytest.raises(BadRequest, match="arm: no poses for Earth without a turret: the best torques differ"):
        earth_reference(arm_named("nominal"), no_progress)


def test_the_same_seed_gives_the_same_campaign():
    plan = CampaignPlan(resize_groups(PAPER_GROUPS, 8), seed=3)
    one, other = (data_sha256(simulate_campaign(arm_named("as-built:3"), plan)) for _ in range(2))
    assert one == other


@pytest.mark.slow
def test_in_the_closed_loop_the_true_arm_is_measured():
    arm = arm_named("as-built:5")
    reference = earth_reference(arm, no_progress)
    found = run_campaign(arm, reference, CampaignPlan(resize_groups(PAPER_GROUPS, 4)), no_progress)
    assert found.count == 4
    assert np.all(found.targets_seen >= 3)
    assert np.all(found.misfit_m < 1.5e-4)
    truth = true_poses(arm, found.believed, zero_errors_rad(arm, reference))
    off = error_screw(truth, found.measured.X_RT)[3:]
    assert np.linalg.norm(off, axis=0).max() < 0.3e-3

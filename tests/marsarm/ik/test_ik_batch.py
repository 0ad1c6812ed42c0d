"""Inverse kinematics of many targets, from a file into a file."""

import json

import numpy as np
import pytest
from pyarrow import parquet

from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict
from fsw.kinematics.transforms import select_targets
from marsarm.ik.solve import BATCH_SIZE
from marsarm.ik.targets import JOINT_NAMES, VERDICT_NAMES
from sim.frames import approach_from, random_targets
from tests.marsarm.command import marsarm
from tests.marsarm.ik.batch import expected, save, solved


@pytest.mark.parametrize("suffix", [".npz", ".parquet"])
def test_a_file_of_arrays_holds_every_answer_to_every_target(tmp_path, suffix):
    save(tmp_path / f"in{suffix}")
    solved(tmp_path / f"in{suffix}", tmp_path / "out.npz", tool="mahli", tilt_roll_deg=10.0)
    answers = expected(tool="mahli", tilt_roll_deg=10.0)
    with np.load(tmp_path / "out.npz", allow_pickle=False) as file:
        angles = answers.output_rad.transpose(2, 1, 0)
        assert np.allclose(file["output_rad"], angles, atol=1e-9, equal_nan=True)
        assert np.array_equal(file["verdict"], answers.verdict.T)
        assert file["output_rad"].shape == (4, 8, 5)
        assert tuple(file["branch_names"]) == BRANCHES
        assert tuple(file["verdict_names"]) == VERDICT_NAMES
        outside = file["verdict"] == BranchVerdict.OUTSIDE_LIMITS
        assert np.all((file["joint"] >= 0) == outside)
        assert np.all(file["excess"][outside] > 0.0)
        assert file["forward_error"][file["verdict"] == BranchVerdict.VALID].max() < 1e-8
        assert json.loads(str(file["about"]))["tilt_roll_deg"] == 10.0


@pytest.mark.parametrize("suffix", [".npz", ".parquet"])
def test_a_table_has_a_row_for_each_target_and_branch(tmp_path, suffix):
    save(tmp_path / f"in{suffix}")
    solved(tmp_path / f"in{suffix}", tmp_path / "out.parquet", compensate="off")
    answers = expected(compensate="off")
    rows = parquet.read_table(tmp_path / "out.parquet").to_pylist()
    assert len(rows) == answers.verdict.size
    for row in rows:
        slot = BRANCHES.index(row["branch"])
        one = select_targets(answers, row["target"])
        angles = np.array([row[f"{joint}_rad"] for joint in JOINT_NAMES], dtype=float)
        assert row["verdict"] == VERDICT_NAMES[one.verdict[slot]]
        assert np.allclose(angles, one.output_rad[:, slot], atol=1e-9, equal_nan=True)
        assert (row["limiting_joint"] is not None) == (row["verdict"] == "outside_limits")
        assert (row["beyond_limit_rad"] is not None) == (row["verdict"] == "outside_limits")
        assert (row["out_of_reach_m"] is not None) == (row["verdict"] == "out_of_reach")


def test_targets_beyond_one_part_are_answered_as_if_they_were_alone(tmp_path):
    p_m, angles = random_targets(np.random.default_rng(3), BATCH_SIZE + 2)
    approach = approach_from(angles).T
    save(tmp_path / "in.npz", p_m.T, approach)
    report = solved(tmp_path / "in.npz", tmp_path / "out.npz")
    assert report.tally.targets == BATCH_SIZE + 2
    alone = expected(p_m.T[BATCH_SIZE:], approach[BATCH_SIZE:])
    with np.load(tmp_path / "out.npz") as file:
        assert file["verdict"].shape[0] == BATCH_SIZE + 2
        assert np.array_equal(file["verdict"][BATCH_SIZE:], alone.verdict.T)


def test_the_same_targets_give_the_same_bytes(tmp_path):
    save(tmp_path / "in.npz")
    for suffix in (".npz", ".parquet"):
        first, second = tmp_path / f"first{suffix}", tmp_path / f"second{suffix}"
        solved(tmp_path / "in.npz", first)
        solved(tmp_path / "in.npz", second)
        assert first.read_bytes() == second.read_bytes()


def test_a_summary_for_programs_and_for_people(tmp_path):
    save(tmp_path / "in.npz")
    words = ("ik", "--batch", "in.npz", "--out", "out.parquet", "--tool", "portion")
    done = marsarm(tmp_path, *words, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert document["targets"] == 4
    assert sum(document["targets_by_valid_branches"].values()) == pytest.approx(1.0)
    assert sum(document["out_by_verdict"].values()) == pytest.approx(1.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.npz", document["out"]]
    done = marsarm(tmp_path, *words)  # replaces what was there
    assert done.returncode == 0, done.stderr
    for word in ("4 targets", "shoulder-out elbow-up wrist-up", "outside limits", "out.parquet"):
        assert word in done.stdout


def test_an_output_through_a_link_replaces_the_file_and_not_the_link(tmp_path):
    save(tmp_path / "in.npz")
    (tmp_path / "real.npz").write_text("old")
    (tmp_path / "link.npz").symlink_to("real.npz")
    solved(tmp_path / "in.npz", tmp_path / "link.npz")
    assert (tmp_path / "link.npz").is_symlink()
    assert (tmp_path / "real.npz").stat().st_size > 1000

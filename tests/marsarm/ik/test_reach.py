"""Reach map of the primary workspace, and its picture."""

import numpy as np
import PIL.Image
import pytest

from marsarm.ik.reach import reach, reach_document
from marsarm.ik.request import ReachRequest
from sim.frames import approach_from, random_targets
from simgap.common.report import to_json
from tests.marsarm.command import marsarm


@pytest.fixture(scope="module")
def document():
    return to_json(reach_document(reach(ReachRequest(samples=4000, picture=None))))


def test_nearly_every_target_of_the_workspace_has_a_branch_and_at_most_four(document):
    shares = document["targets_by_valid_branches"]
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares.get("0", 0.0) < 0.005
    assert document["targets_with_at_most_four"] > 0.99


def test_the_branches_of_the_workspace_are_elbow_up(document):
    for name, share in document["valid_by_branch"].items():
        assert (share > 0.5) == ("elbow-up" in name), name


def test_the_elevation_limit_is_what_stands_in_the_way(document):
    assert sum(document["out_by_verdict"].values()) == pytest.approx(1.0)
    by_joint = document["outside_limits_by_joint"]
    assert sum(by_joint.values()) == pytest.approx(document["out_by_verdict"]["outside_limits"])
    assert by_joint["elevation"] > 0.85


def test_the_workspace_is_the_cylinder_and_the_wedge():
    p_N_m, angles = random_targets(np.random.default_rng(0), 5000)
    from_axis = np.hypot(p_N_m[0] - 2.1, p_N_m[1])
    assert 0.39 < from_axis.max() <= 0.4
    assert -0.8 <= p_N_m[2].min() < -0.79
    assert 0.19 < p_N_m[2].max() <= 0.2
    forward, right, down = approach_from(angles)
    assert down.min() >= 0.0
    assert np.all(np.abs(right) <= forward + 1e-12)
    assert np.allclose(forward**2 + right**2 + down**2, 1.0)


def test_the_picture_is_drawn_and_named(tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "nonsense")
    done = marsarm(tmp_path, "reach", "--samples", "500", "--tool", "drill")
    assert done.returncode == 0, done.stderr
    for word in ("500 random targets", "at most four", "shoulder-in elbow-up wrist-down", "reach.png"):
        assert word in done.stdout
    with PIL.Image.open(tmp_path / "reach.png") as picture:
        assert picture.size == (1540, 605)
    assert [path.name for path in tmp_path.iterdir()] == ["reach.png"]

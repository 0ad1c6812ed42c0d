"""Reach map of the primary workspace, and its picture."""

import json
import sys

import numpy as np
import PIL.Image
import pytest

from marsarm.common.pool import run_here
from marsarm.ik.reach import reach, reach_document, sample_workspace
from marsarm.ik.request import ModelRequest, ReachRequest
from marsarm.ik.solve import build_ik_model
from sim.frames import approach_from, random_surface, random_targets
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from tests.marsarm.command import marsarm, marsarm_process


def quiet(*_) -> None:
    """Ignore progress."""


@pytest.fixture(scope="module")
def document():
    return to_json(reach_document(reach(ReachRequest(samples=4000, picture=None), quiet)))


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


def test_the_same_seed_is_the_same_map_and_another_is_not():
    model = build_ik_model(ModelRequest(compensate="off"))
    first, again, other = (sample_workspace(model, 300, seed, run_here, quiet)[0] for seed in (1, 1, 2))
    assert np.array_equal(first.valid, again.valid)
    assert np.array_equal(first.p_NoTo_N_m, again.p_NoTo_N_m)
    assert not np.array_equal(first.p_NoTo_N_m, other.p_NoTo_N_m)


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


def test_a_placement_campaign_draws_from_the_same_workspace():
    point, normal = random_surface(np.random.default_rng(7))
    p_N_m, angles = random_targets(np.random.default_rng(7), 1)
    assert point == tuple(p_N_m[:, 0])
    assert normal == tuple(-approach_from(angles)[:, 0])


def test_the_picture_is_drawn_and_named(tmp_path):
    done = marsarm_process(tmp_path, "reach", "--samples", "500", "--tool", "drill", MPLBACKEND="nonsense")
    assert done.returncode == 0, done.stderr
    for word in ("500 random targets", "at most four", "shoulder-in elbow-up wrist-down", "reach.png"):
        assert word in done.stdout
    with PIL.Image.open(tmp_path / "reach.png") as picture:
        assert picture.size == (1540, 990)
    assert [path.name for path in tmp_path.iterdir()] == ["reach.png"]


@pytest.mark.parametrize("samples", [1, 50])
def test_a_map_of_few_targets_is_drawn_too(tmp_path, samples):
    path = tmp_path / "few.png"
    report = reach(ReachRequest(ModelRequest(tool="portion"), samples, picture=path), quiet)
    assert report.picture_problem is None
    assert path.stat().st_size > 10_000


def test_without_matplotlib_there_is_a_message_and_no_picture(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    report = reach(ReachRequest(samples=50, picture=tmp_path / "reach.png"), quiet)
    document = to_json(reach_document(report))
    assert document["picture"] is None
    assert "pip install matplotlib" in document["picture_problem"]
    assert list(tmp_path.iterdir()) == []


def test_with_json_there_is_one_document(tmp_path):
    done = marsarm(tmp_path, "reach", "--samples", "50", "--no-picture", "--json", "--gravity", "earth")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["gravity"] == "earth"
    assert json.loads(done.stdout)["picture"] is None
    assert list(tmp_path.iterdir()) == []


BAD = {
    "no samples": (("--samples", "0"), "samples: 0 is not within 1 .. 1000000"),
    "too many samples": (("--samples", "1" + 30 * "0"), "is not within 1 .. 1000000"),
    "negative seed": (("--seed", "-1"), "seed: -1 is below 0"),
    "no such tool": (("--tool", "spoon"), "tool: 'spoon' is not known"),
    "no such compensation": (("--compensate", "relative"), "compensate: 'relative' is not known"),
    "too much tilt": (("--tilt-pitch", "-31"), "up to 30 deg"),
    "picture of another kind": (("--picture", "p.jpg"), "its name must end in .png"),
    "picture in no folder": (("--picture", "nowhere/p.png"), "there is no folder nowhere"),
    "picture over params": (("--picture", "./good.png", "--params", "good.png"), "the file of params"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_a_sentence_and_status_2_and_writes_nothing(tmp_path, case):
    (tmp_path / "good.png").write_text("[joints.elbow]\nspeed_rad_s = 0.01\n")
    words, said = BAD[case]
    done = marsarm(tmp_path, "reach", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["good.png"]


def test_a_request_is_checked_before_anything_is_sampled():
    with pytest.raises(BadRequest, match="seed"):
        reach(ReachRequest(seed=-1, samples=1), quiet)

"""`marsarm ik` for one target: results and refused requests; the reach map of the primary workspace."""

import json

import numpy as np
import PIL.Image
import pytest

from fsw.kinematics.arm import build_arm, heat_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle
from marsarm.ik.reach import reach, reach_document
from marsarm.ik.request import IkRequest, ModelRequest, ReachRequest
from marsarm.ik.solve import ik_document, make_targets, solve
from sim.arms import arm_named
from sim.frames import approach_from, p_R_from_N, random_targets
from sim.setting import World
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from tests.marsarm.command import marsarm

POSITION = (2.1, 0.1, -0.3)
APPROACH = (0.5, 0.1, 0.8)


def answer(**model):
    return to_json(ik_document(solve(IkRequest(ModelRequest(**model), POSITION, APPROACH))))


def valid_poses(document) -> np.ndarray:
    """Return the output angles of the valid branches, shape (5, n)."""
    valid = [b["output_deg"] for b in document["branches"] if b["verdict"] == "valid"]
    return np.radians(np.array(valid).T)


def misses(X_RT, position, approach) -> tuple[float, float]:
    """Compute the largest errors at a target in RNAV: metres, and radians."""
    p_R_m, unit = p_R_from_N(np.array(position)), np.array(approach) / np.linalg.norm(approach)
    return np.abs(X_RT.p - p_R_m[:, None]).max(), np.abs(X_RT.R[:, 0] - unit[:, None]).max()


@pytest.mark.parametrize("gravity", ["mars", "earth"])
def test_the_tilted_hanging_arm_meets_its_target_where_the_rigid_one_would_not(gravity):
    world = World(gravity, np.radians(15.0), np.radians(-12.0))
    arm = build_arm(arm_named("calibrated:3").params)
    model = {"tool": "drill", "arm": "calibrated:3", "gravity": gravity}
    compensated = valid_poses(answer(tilt_roll_deg=15.0, tilt_pitch_deg=-12.0, **model))
    rigid = valid_poses(answer(compensate="off", **model))

    def deflected(output_rad):
        motor_rad, gap = output_rad, np.zeros_like(output_rad)
        for _ in range(20):  # find the motor angle for which the wound-up gear gives this output
            motor_rad = motor_rad + output_rad - settle(arm, motor_rad, gap, world.gravity_N_m_s2).output_rad
        return tool_pose(arm, settle(arm, motor_rad, gap, world.gravity_N_m_s2).frames, "drill")

    assert max(misses(deflected(compensated), POSITION, APPROACH)) < 1e-7
    assert misses(deflected(rigid), POSITION, APPROACH)[0] > 1e-3


def test_a_warm_arm_is_answered_as_the_warm_arm_that_it_is():
    document = answer(tool="mahli", compensate="off", warming_K=60.0)
    arm = heat_arm(build_arm(arm_named("nominal").params), 60.0)
    X_RT = tool_pose(arm, forward(arm, valid_poses(document)), "mahli")
    assert max(misses(X_RT, POSITION, APPROACH)) < 1e-9


def test_a_branch_out_of_limits_says_which_joint_and_by_how_much():
    """The rigid arm shows its angles too; those of the deflected arm may be unknown far beyond limits."""
    for document in (answer(), answer(compensate="off")):
        outside = [b for b in document["branches"] if b["verdict"] == "outside_limits"]
        assert outside
        for branch in outside:
            assert f"joint {branch['limiting_joint']}:" in branch["reason"]
            assert branch["beyond_limit_deg"] > 0.0
            has_angles = branch["output_deg"] is not None
            assert has_angles or (document["compensate"] == "absolute" and "about" in branch["reason"])


@pytest.mark.parametrize("position_m", [np.zeros((4, 3)), np.zeros(3), 0.0, [[1.0, 2.0]] * 3], ids=str)
def test_positions_and_directions_of_other_shapes_are_refused(position_m):
    with pytest.raises(BadRequest, match=r"have the shapes .* and \(3, 1\); both must have \(3, n\)"):
        make_targets(position_m, np.ones((3, 1)))


def test_of_many_targets_the_wrong_one_is_named():
    position_m = np.array([[2.0, 0.0, np.nan], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(BadRequest, match=r"^position\[2\]: nan 0 0 is not three finite numbers"):
        make_targets(position_m, np.ones((3, 3)))


def test_a_target_that_no_branch_reaches_has_the_status_of_a_refusal(tmp_path):
    words = ("ik", "--position", "15", "0", "0", "--approach", "1", "0", "0")
    assert "no branch reaches the target" in marsarm(tmp_path, *words).stdout
    done = marsarm(tmp_path, *words, "--json")
    assert (done.returncode, done.stderr) == (3, "")
    document = json.loads(done.stdout)
    assert document["valid"] == 0
    assert len(document["branches"]) >= 8
    assert all("out of reach by 1" in branch["reason"] for branch in document["branches"])
    assert all(branch["output_deg"] is None for branch in document["branches"])


def test_people_see_every_branch_whole_on_however_narrow_a_terminal(tmp_path, monkeypatch):
    words = ("ik", "--position", "2.1", "0.1", "-0.3", "--approach", "0.5", "0.1", "0.8", "--tilt-roll", "5")
    monkeypatch.setenv("COLUMNS", "40")
    done = marsarm(tmp_path, *words)
    assert done.returncode == 0, done.stderr
    assert "roll 5 pitch 0 deg: " in done.stdout
    for branch in answer(tilt_roll_deg=5.0)["branches"]:
        (line,) = (line for line in done.stdout.splitlines() if branch["branch"] in line)
        assert branch["reason"] is None or line.endswith(branch["reason"])
        assert all(f"{angle:.3f}" in line for angle in branch["output_deg"] or ())
    assert list(tmp_path.iterdir()) == []


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

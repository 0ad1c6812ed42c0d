"""`marsarm ik` for one target: results and refused requests."""

import json

import numpy as np
import pytest

from fsw.kinematics.arm import build_arm, heat_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle
from marsarm.ik.request import IkRequest, ModelRequest
from marsarm.ik.solve import ik_document, make_targets, solve
from sim.arms import arm_named
from sim.frames import p_R_from_N
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

"""`marsarm ik` for one target: results and refused requests."""

import json

import numpy as np
import pytest

from fsw.kinematics.arm import build_arm, heat_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle
from marsarm.ik.request import IkRequest, ModelRequest
from marsarm.ik.solve import ik_document, solve
from sim.arms import arm_named
from sim.frames import p_R_from_N
from sim.world import World
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from tests.marsarm.command import marsarm, marsarm_process
from tests.tools import TOOLS

POSITION = (2.1, 0.1, -0.3)
APPROACH = (0.5, 0.1, 0.8)


def answer(position=POSITION, approach=APPROACH, frame="rnav", **model):
    request = IkRequest(ModelRequest(**model), frame, position, approach)
    return to_json(ik_document(solve(request, lambda *_: None)))


def valid_poses(document) -> np.ndarray:
    """Return the output angles of the valid branches, shape (5, n)."""
    valid = [b["output_deg"] for b in document["branches"] if b["verdict"] == "valid"]
    return np.radians(np.array(valid).T)


def misses(X_RT, position, approach) -> tuple[float, float]:
    """Compute the largest errors at a target in RNAV: metres, and radians."""
    p_R_m, unit = p_R_from_N(np.array(position)), np.array(approach) / np.linalg.norm(approach)
    return np.abs(X_RT.p - p_R_m[:, None]).max(), np.abs(X_RT.R[:, 0] - unit[:, None]).max()


@pytest.mark.parametrize("tool", TOOLS)
def test_the_rigid_arm_points_every_tool_where_it_was_asked(tool):
    document = answer(tool=tool, compensate="off")
    assert document["valid"] > 0
    arm = build_arm(arm_named("nominal").params)
    X_RT = tool_pose(arm, forward(arm, valid_poses(document)), tool)
    assert max(misses(X_RT, POSITION, APPROACH)) < 1e-9


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


def test_a_position_in_either_frame_is_the_same_place():
    there = tuple(float(v) for v in p_R_from_N(np.array(POSITION)))
    here, same = answer(), answer(position=there, frame="rmech")
    assert here["branches"] == same["branches"]


def test_the_length_of_the_approach_does_not_matter_however_large():
    once, huge = (
        answer(approach=tuple(scale * v for v in APPROACH))["branches"] for scale in (1.0, 2.0**1023)
    )
    assert huge == once


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


def test_a_target_out_of_reach_is_an_answer_and_no_error(tmp_path):
    done = marsarm(tmp_path, "ik", "--position", "15", "0", "0", "--approach", "1", "0", "0", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert document["valid"] == 0
    assert len(document["branches"]) >= 8
    assert all("out of reach by 1" in branch["reason"] for branch in document["branches"])
    assert all(branch["output_deg"] is None for branch in document["branches"])


def test_people_see_every_branch_whole_on_however_narrow_a_terminal(tmp_path):
    words = ("ik", "--position", "2.1", "0.1", "-0.3", "--approach", "0.5", "0.1", "0.8", "--tilt-roll", "5")
    done = marsarm_process(tmp_path, *words, COLUMNS="40")
    assert done.returncode == 0, done.stderr
    assert "roll 5 pitch 0 deg: " in done.stdout
    for branch in answer(tilt_roll_deg=5.0)["branches"]:
        (line,) = (line for line in done.stdout.splitlines() if branch["branch"] in line)
        assert (branch["reason"] or "valid") in line
        assert all(f"{angle:.3f}" in line for angle in branch["output_deg"] or ())
    assert list(tmp_path.iterdir()) == []


BAD_FIELDS = {
    "no direction": ({"approach": (0.0, 0.0, 0.0)}, "approach: 0 0 0 has no direction"),
    "next to no direction": ({"approach": (0.0, 1e-9, 0.0)}, "approach: 0 1e-09 0 has no direction"),
    "NaN position": ({"position": (np.nan, 0.0, 0.0)}, "position: nan 0 0 is not three finite"),
    "infinite approach": ({"approach": (np.inf, 0.0, 0.0)}, "approach: inf 0 0 is not three finite"),
    "absurdly far": ({"position": (1e300, 1e300, 0.0)}, "position: 1e+300 1e+300 0 m is farther than 20 m"),
    "no position": ({"position": None}, "position and approach: give both"),
    "no approach": ({"approach": None}, "position and approach: give both"),
    "no such tool": ({"tool": "spoon"}, "there are drill, drt, mahli, apxs, portion"),
    "no such frame": ({"frame": "world"}, "frame: 'world' is not known; there are rnav, rmech"),
    "no such compensation": ({"compensate": "some"}, "compensate: 'some' is not known"),
    "no such gravity": ({"gravity": "moon"}, "gravity: 'moon' is not known; there are mars, earth"),
    "no such arm": ({"arm": "as-built"}, "as-built:SEED"),
    "too much tilt": ({"tilt_roll_deg": 30.1}, "up to 30 deg"),
    "NaN tilt": ({"tilt_pitch_deg": np.nan}, "tilt: 0 nan deg is not finite"),
    "too warm": ({"warming_K": 1e300}, "warming: 1e+300 K is not within 200 K"),
    "NaN warming": ({"warming_K": np.nan}, "warming: nan K"),
}


@pytest.mark.parametrize("case", BAD_FIELDS)
def test_a_wrong_field_is_named_in_a_sentence(case):
    fields, said = BAD_FIELDS[case]
    with pytest.raises(BadRequest) as refused:
        answer(**fields)
    assert said in str(refused.value)


ONE = ("--position", "2.1", "0", "-0.3", "--approach", "0", "0", "1")
BAD_WORDS = {
    "nothing asked": ((), "position and approach: give both"),
    "a batch without answers": (("--batch", "in.npz"), "batch and out: give both"),
    "answers without a batch": (("--out", "out.npz", *ONE), "batch and out: give both"),
    "a batch and a target": (("--batch", "in.npz", "--out", "out.npz", *ONE), "give one or the other"),
    "too few numbers": (("--position", "1"), "3 arguments"),
    "no numbers": (("--position", "a", "b", "c"), "number"),
    "params missing": ((*ONE, "--params", "none.toml"), "none.toml"),
    "params unknown": ((*ONE, "--params", "unknown.toml"), "joints.elbow.spede_rad_s"),
}


@pytest.mark.parametrize("case", BAD_WORDS)
def test_bad_input_is_a_sentence_and_status_2(tmp_path, case):
    (tmp_path / "unknown.toml").write_text("[joints.elbow]\nspede_rad_s = 0.01\n")
    words, said = BAD_WORDS[case]
    done = marsarm(tmp_path, "ik", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert "Warning" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["unknown.toml"]


def test_bad_input_with_json_is_still_one_document(tmp_path):
    done = marsarm(tmp_path, "ik", "--json", "--batch", "in.npz")
    assert done.returncode == 2
    assert json.loads(done.stdout)["error"] == done.stderr.strip()


@pytest.mark.parametrize("verb", ["ik", "reach"])
def test_help_comes_with_an_example_and_with_the_frame(tmp_path, verb):
    done = marsarm(tmp_path, verb, "--help")
    assert done.returncode == 0
    assert f"Example: marsarm {verb}" in done.stdout
    assert "rnav" in done.stdout.lower()

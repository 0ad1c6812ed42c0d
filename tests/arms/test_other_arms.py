"""Two other arms: that of Perseverance, and a small one."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.dictionary.enums import HARDSTOP_ORDER
from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from marsarm.calibration.calibrate import calibrate, rms_m
from marsarm.calibration.campaign import PAPER_GROUPS, CampaignPlan, resize_groups
from marsarm.calibration.execution import check_data, check_fit
from marsarm.calibration.verify import simulate_campaign
from marsarm.common.pool import local_runner
from marsarm.ik.reach import sample_workspace
from marsarm.ik.request import ModelRequest
from marsarm.ik.solve import build_ik_model
from marsarm.runs.place import place, prepare_placement
from marsarm.runs.request import PlaceRequest, RunFiles
from sim.arm_check import check_arm
from sim.arm_model.description import BadArm
from sim.arm_model.load import ARMS, default_arm, load_arm
from sim.arms import arm_named
from sim.frames import P_NR_M, approach_from, random_targets
from sim.initialisation import initialise_joints
from sim.placement import preview_placement
from sim.plant import Plant
from sim.sequence import Outcome
from sim.setting import World
from sim.world import build, inside_rover
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from tests.marsarm.command import marsarm

NAME = "m2020"
MODEL = load_arm(NAME)
PARAMS = MODEL.params
MARS = World()
MOST_HOMING_ERROR_RAD = 0.3e-3


def test_its_azimuth_joint_is_where_the_rover_carries_it_and_it_weighs_what_it_weighs():
    X = build_arm(PARAMS)
    start = forward(X, np.zeros((5, 1)), np.zeros((6, 6, 1))).X_RF[0].p[:, 0]
    np.testing.assert_allclose(start + P_NR_M, [0.0900 + 1.1756, -0.4515, 0.3116 - 1.13338], atol=1e-9)
    assert build(MARS, MODEL).compile().body("turret").mass[0] == PARAMS.links.arm6.far.mass_kg == 40.0


def test_plant_and_flight_software_put_its_tools_in_the_same_places():
    rng, arm, plant = np.random.default_rng(24), build_arm(PARAMS), Plant(build(MARS, MODEL).compile())
    low, high = arm.soft_min_rad[:, None], arm.soft_max_rad[:, None]
    poses = low + (high - low) * rng.uniform(size=(5, 20))
    settled = settle_output(arm, poses, MARS.gravity_N_m_s2)
    for k, output in enumerate(poses.T):
        plant.show(output, settled.strain[:, :, k])
        truth = plant.truth()
        for index, tool in enumerate(plant.tools):
            X = tool_pose(arm, settled.frames, tool)
            np.testing.assert_allclose(truth.p_RoTo_R_m[index], X.p[:, k], atol=1e-9)
            np.testing.assert_allclose(truth.R_RT[index], X.R[:, :, k], atol=1e-9)


@pytest.mark.parametrize("tool", PARAMS.tool_names)
def test_inverse_kinematics_lead_back_to_their_targets(tool):
    arm = build_arm(PARAMS)
    p_N, angles = random_targets(np.random.default_rng(7), 200)
    p_R, approach = p_N - P_NR_M[:, None], approach_from(angles)
    found = inverse_kinematics(arm, tool, p_R, approach, MARS.gravity_N_m_s2)
    valid = found.verdict == BranchVerdict.VALID
    assert np.mean(valid.any(axis=0)) > 0.9
    slots, targets = np.nonzero(valid)
    settled = settle_output(arm, found.output_rad[:, slots, targets], MARS.gravity_N_m_s2)
    X = tool_pose(arm, settled.frames, tool)
    np.testing.assert_allclose(X.p, p_R[:, targets], atol=1e-6)
    np.testing.assert_allclose(X.R[:, 0], approach[:, targets], atol=1e-6)


@pytest.mark.slow
def test_a_calibrated_one_finds_its_hardstops_and_places_its_instrument(monkeypatch):
    homed = []

    def initialise_and_keep(arm, seed):
        for one in initialise_joints(arm, seed=seed):
            homed.append(one)
            yield one

    monkeypatch.setattr("marsarm.runs.execution.initialise_joints", initialise_and_keep)
    report = place(PlaceRequest(arm=f"{NAME}/calibrated:1", files=RunFiles()))
    assert [one.stops[-1].joint for one in homed] == list(HARDSTOP_ORDER)
    for one in homed:
        (stop,) = one.stops
        assert abs(stop.zero_error_rad) < MOST_HOMING_ERROR_RAD
        assert one.max_torque_Nm[stop.joint] < PARAMS.joints.in_order()[stop.joint].hardstop_rated_Nm
    result = report.execution.result
    assert report.tool == MODEL.description.instrument
    assert result.outcome is Outcome.DONE
    assert result.contact is not None
    assert result.contact.total_m < 5e-3


@pytest.mark.parametrize("target_m", [(2.05, 0.1, -0.25), (2.1, 0.0, -0.2), (2.0, -0.2, -0.1)])
def test_it_reaches_targets_from_its_stowed_pose(target_m):
    job = prepare_placement(PlaceRequest(arm=NAME, target_m=target_m, files=RunFiles()))
    assert preview_placement(job.arm, job.world, job.placement, stowed=True).problem is None


@pytest.mark.slow
def test_calibration_brings_the_error_at_held_out_poses_to_a_fifth():
    arm = arm_named(f"{NAME}/as-built:1")
    campaign = simulate_campaign(arm, CampaignPlan(resize_groups(PAPER_GROUPS, 60)))
    check_data(PARAMS, campaign)
    found = calibrate(PARAMS, campaign, built=MODEL.description.tolerances.built)
    check_fit(found)
    before = rms_m(found.before[:, found.held_out_poses])
    assert rms_m(found.held_out_error) < 0.2 * before


def test_a_stranger_to_its_tools_is_refused():
    request = replace(PlaceRequest(arm=NAME, files=RunFiles()), tool="mast")
    with pytest.raises(BadRequest, match="fcs"):
        prepare_placement(request)


SCALE = 0.4
V_m = (0.0, 0.0, -0.3)
"""Origin of the frame of its rover, in RNAV."""
SHOULDER_m = (0.55, -0.15, -0.3)
"""Azimuth joint in that frame."""
CLEAR_m, TOO_NEAR_m = 0.2, 0.5
"""Fronts of its rover in that frame, which leave room for the arm, and which do not."""
BASE = f"""[links.arm1]
transform = {{ a_m = {SHOULDER_m[0]}, b_m = {SHOULDER_m[1]}, d_m = {SHOULDER_m[2]} }}
expansion_1_K = 23e-6
elastic_centre_m = {list(SHOULDER_m)}
stiffness = [40e3, 60e3, 80e3, 2e6, 2e6, 2e6]
far = {{ mass_kg = 19.3, com_m = {list(SHOULDER_m)}, inertia_kg_m2 = [0.3, 0.3, 0.3] }}

"""
ROVER = """
[rover]
p_NoVo_N_m = {origin}
[rover.hull]
body = [{{ centre_m = [{middle}, 0.0, -0.25], half_m = [0.4, 0.3, 0.15] }}]
[workspace]
centre_x_m = 0.95
centre_y_m = -0.15
radius_m = 0.1
top_z_m = -0.5
bottom_z_m = -0.1
"""


def scaled(text: str) -> str:
    """Scale all lengths of an arm, but neither what taught points are, nor the pads."""
    text = text[: text.index("[[teach]]")]

    def of(match: re.Match[str]) -> str:
        return match[1] + re.sub(r"-?\d+\.\d+", lambda number: repr(SCALE * float(number[0])), match[2])

    names = r"(?<![a-z])(?:[abd]|from|to|centre|half|half_length|radius|elastic_centre|com|p)_m = "
    return re.sub(rf"({names})(\[[^\]]*\]|-?\d+\.\d+)", of, text)


def small_arm(folder: Path, front_m: float, old: str = "", new: str = "") -> Path:
    """Write the arm on a rover whose front is at this x, with another text in place of one."""
    text = scaled((ARMS / default_arm().name / "arm.toml").read_text())
    text = text.replace(f'name = "{default_arm().name}"', 'name = "small"', 1)
    text = re.sub(r"\[links\.arm1\].*?(?=\[links\.arm2\])", BASE, text, flags=re.DOTALL)
    text += ROVER.format(origin=list(V_m), middle=front_m - 0.4)
    folder.mkdir(exist_ok=True)
    (folder / "arm.toml").write_text(text.replace(old, new))
    return folder


def test_with_room_it_can_be_homed_and_stowed_and_reaches_its_workspace(tmp_path):
    check_arm(load_arm(str(small_arm(tmp_path, CLEAR_m))))


@pytest.mark.parametrize(
    "words",
    [
        ("arm", "--build", "small"),
        ("place", "--arm", "small"),
        ("calibrate", "--arm", "small"),
        ("hardstop", "--arm", "small"),
        ("run", "sampling", "--arm", "small"),
    ],
    ids=lambda words: words[0],
)
def test_near_its_rover_it_is_refused_with_joint_and_distance(tmp_path, words):
    small_arm(tmp_path / "small", TOO_NEAR_m)
    done = marsarm(tmp_path, *words)
    assert done.returncode == 2
    assert re.search(
        r"joint azimuth cannot be homed: at -?\d+\.\d deg the link2 is \d+ mm inside the body", done.stderr
    )
    assert [path.name for path in (tmp_path / "small").iterdir()] == ["arm.toml"]


def test_a_stowed_pose_in_the_rover_is_refused(tmp_path):
    with pytest.raises(BadArm, match="cannot be stowed: the link2 is 39 mm inside the body"):
        check_arm(load_arm(str(small_arm(tmp_path, TOO_NEAR_m))))


def test_a_workspace_out_of_its_reach_is_refused(tmp_path):
    small_arm(tmp_path, CLEAR_m, "centre_x_m = 0.95", "centre_x_m = 2.1")
    with pytest.raises(BadArm, match=r"tool APXS reaches none of 300 .* around 2\.1 -0\.15 -0\.3"):
        check_arm(load_arm(str(tmp_path)))


def test_a_start_from_which_gravity_stalls_the_joint_is_refused(tmp_path):
    text = (ARMS / "m2020" / "arm.toml").read_text()
    (tmp_path / "arm.toml").write_text(
        text.replace("park_rad = [-2.9752, -1.7,", "park_rad = [-2.9752, -2.014,")
    )
    with pytest.raises(
        BadArm, match=r"joint elbow .* 132\.1 deg, where it starts, gravity pulls it away with 155"
    ):
        check_arm(load_arm(str(tmp_path)))


def test_its_base_and_hull_are_where_its_own_frame_says(tmp_path):
    arm = load_arm(str(small_arm(tmp_path, CLEAR_m)))
    start_R_m = forward(build_arm(arm.params), np.zeros((5, 1)), np.zeros((6, 6, 1))).X_RF[0].p[:, 0]
    np.testing.assert_allclose(start_R_m + P_NR_M, np.add(V_m, SHOULDER_m), atol=1e-12)
    model = build(World(), arm).compile()
    np.testing.assert_allclose(model.geom("body").pos, [CLEAR_m - 0.4, 0.0, -0.55], atol=1e-12)
    assert [part.name for part in arm.params.collision.rover] == ["body"]
    assert inside_rover((0.1, 0.0, -0.5), arm)
    assert not inside_rover((0.68, 0.48, -1.5), arm)  # Curiosity's mast


@pytest.mark.parametrize("name", ["ground", "surface", "rock_face", "terrace", "probe"])
def test_a_part_of_its_rover_with_the_name_of_a_shape_of_the_scene_is_refused(tmp_path, name):
    small_arm(tmp_path, CLEAR_m, "\nbody = [", f"\n{name} = [")
    with pytest.raises(BadArm, match=f"rover.hull.{name}: is no name, or that of another part"):
        load_arm(str(tmp_path))


def test_reach_draws_from_its_own_workspace(tmp_path):
    model = build_ik_model(ModelRequest(arm=str(small_arm(tmp_path, CLEAR_m))))
    samples, counted = sample_workspace(model, 200, 1, local_runner(1), no_progress)
    x, y, z = samples.p_NoTo_N_m
    assert np.hypot(x - 0.95, y + 0.15).max() <= 0.1
    assert -0.5 <= z.min() < z.max() <= -0.1
    assert counted.targets_by_valid[0] < 20


def test_a_file_without_rover_and_workspace_has_those_of_curiosity():
    arm = default_arm()
    assert (arm.workspace.centre_x_m, arm.workspace.radius_m) == (2.1, 0.4)
    assert [part.name for part in arm.params.collision.rover][:2] == ["chassis", "shoulder_bracket"]
    assert not arm.has_own_rover

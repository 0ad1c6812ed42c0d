"""The arm of Mars 2020, made of its files alone, does what Curiosity's arm does."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from marsarm.calibration.calibrate import calibrate, rms_m
from marsarm.calibration.campaign import PAPER_GROUPS, CampaignPlan, resize_groups
from marsarm.calibration.execution import check_data, check_fit
from marsarm.calibration.verify import simulate_campaign
from marsarm.runs.place import place, prepare_placement
from marsarm.runs.request import PlaceRequest, RunFiles
from sim.arm_model.load import load_arm
from sim.arms import arm_named
from sim.frames import P_NR_M, approach_from, random_targets
from sim.initialisation import prepare_homing, prepare_random_homing
from sim.placement import preview_placement
from sim.plant import Plant
from sim.sequence import Outcome
from sim.setting import World
from sim.world import build
from simgap.common.errors import BadRequest

NAME = "m2020"
MODEL = load_arm(NAME)
PARAMS = MODEL.params
MARS = World()
MOST_HOMING_ERROR_RAD = 0.3e-3


def test_its_azimuth_joint_is_where_the_rover_carries_it_and_it_weighs_what_it_weighs() -> None:
    X = build_arm(PARAMS)
    start = forward(X, np.zeros((5, 1)), np.zeros((6, 6, 1))).X_RF[0].p[:, 0]
    np.testing.assert_allclose(start + P_NR_M, [0.0900 + 1.1756, -0.4515, 0.3116 - 1.13338], atol=1e-9)
    assert build(MARS, MODEL).compile().body("turret").mass[0] == PARAMS.links.arm6.far.mass_kg == 40.0


def test_plant_and_flight_software_put_its_tools_in_the_same_places() -> None:
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
def test_inverse_kinematics_lead_back_to_their_targets(tool: str) -> None:
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


@pytest.mark.parametrize("joint", [pytest.param(j, marks=pytest.mark.slow) for j in HARDSTOP_ORDER])
def test_each_joint_of_a_built_arm_finds_its_hardstop(joint: Joint) -> None:
    arm = arm_named(f"{NAME}/as-built:3")
    for seed in range(3):
        result = prepare_random_homing(arm, joint, MARS, seed).finish()
        assert result.outcome is Outcome.DONE
        assert abs(result.stops[-1].zero_error_rad) < MOST_HOMING_ERROR_RAD
        assert result.max_torque_Nm[joint] < PARAMS.joints.in_order()[joint].hardstop_rated_Nm


@pytest.mark.slow
@pytest.mark.parametrize("arm", [NAME, f"{NAME}/calibrated:1"])
def test_it_places_its_instrument(arm: str) -> None:
    report = place(PlaceRequest(arm=arm, files=RunFiles()))
    result = report.execution.result
    assert report.tool == MODEL.description.instrument
    assert result.outcome is Outcome.DONE
    assert result.contact is not None
    assert result.contact.total_m < (1e-3 if arm == NAME else 5e-3)


@pytest.mark.parametrize("target_m", [(2.05, 0.1, -0.25), (2.1, 0.0, -0.2), (2.0, -0.2, -0.1)])
def test_it_reaches_targets_from_its_stowed_pose(target_m: tuple[float, float, float]) -> None:
    job = prepare_placement(PlaceRequest(arm=NAME, target_m=target_m, files=RunFiles()))
    assert preview_placement(job.arm, job.world, job.placement, stowed=True).problem is None


@pytest.mark.slow
def test_calibration_brings_the_error_at_held_out_poses_to_a_fifth() -> None:
    arm = arm_named(f"{NAME}/as-built:1")
    campaign = simulate_campaign(arm, CampaignPlan(resize_groups(PAPER_GROUPS, 60)))
    check_data(PARAMS, campaign)
    found = calibrate(PARAMS, campaign, built=MODEL.description.tolerances.built)
    check_fit(found)
    before = rms_m(found.before[:, found.held_out_poses])
    assert rms_m(found.held_out_error) < 0.2 * before


@pytest.mark.slow
def test_equal_runs_have_equal_bits() -> None:
    one, other = (prepare_homing(arm_named(NAME), Joint.TURRET, MARS, seed=5) for _ in range(2))
    for first, second, _ in zip(one, other, range(200), strict=False):
        assert first.sensors.encoder_count.tolist() == second.sensors.encoder_count.tolist()
        assert first.sensors.current_A.tolist() == second.sensors.current_A.tolist()
    assert one.loop.plant.data.qpos.tobytes() == other.loop.plant.data.qpos.tobytes()


def test_a_stranger_to_its_tools_is_refused() -> None:
    request = replace(PlaceRequest(arm=NAME, files=RunFiles()), tool="mast")
    with pytest.raises(BadRequest, match="fcs"):
        prepare_placement(request)

"""Hardstops: poses and loads on the way to each, and the zero and the gap that a joint finds there."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fsw.dictionary.commands import Calibrate, Stop
from fsw.dictionary.enums import Joint, Mode
from fsw.executive.poses import homing_start_poses
from fsw.messages import Sensors
from fsw.motion.homing import HomingStage
from helpers.marks import slow_but
from sim import arm_check
from sim.arms import arm_named
from sim.clearance import ClearanceModel
from sim.effects.environment import Ambient, PowerLoss
from sim.initialisation import InitialisationResult, InitialisationRun, prepare_homing, prepare_random_homing
from sim.sequence import Outcome
from sim.setting import World
from tests.sim import lab

RATED_NM = np.array([joint.hardstop_rated_Nm for joint in arm_named("nominal").params.joints.in_order()])
COLD_C = -55.0


def run_to_end(run: InitialisationRun) -> InitialisationResult:
    """Run to the end and check that no limit is ever exceeded."""
    for _ in run:
        pass
    result = run.result()
    assert np.all(result.max_torque_Nm < RATED_NM)
    assert result.max_current_ratio.max() <= 1.0 + 1e-9
    return result


@cache
def home_nominal(joint: Joint) -> tuple[InitialisationRun, InitialisationResult, np.ndarray]:
    """Home a joint of the nominal arm; return the ended run, its result and the motor angles before it."""
    run = prepare_homing(arm_named("nominal"), joint, World())
    before = run.loop.plant.motor_rad()
    return run, run_to_end(run), before


@pytest.mark.parametrize("joint", slow_but(Joint, Joint.TURRET))
def test_every_joint_of_the_nominal_arm_finds_its_zero_and_its_gap(joint):
    run, result, before = home_nominal(joint)
    assert result.outcome is Outcome.DONE
    (stop,) = result.stops
    assert abs(stop.zero_error_rad) < 0.1e-3
    assert abs(stop.half_backlash_error_rad) < 0.1e-3
    assert list(result.reference.calibrated) == [other is joint for other in Joint]
    assert run.loop.state.joints.side[joint] == np.sign(lab.gear_rad(run.loop.plant)[joint])
    others = [other for other in Joint if other is not joint]
    np.testing.assert_allclose(run.loop.plant.motor_rad()[others], before[others], atol=1e-6)


@pytest.mark.slow
def test_a_joint_repeats_on_other_days_and_with_another_seed():
    elbow = [prepare_random_homing(arm_named("as-built:1"), Joint.ELBOW, World(), seed) for seed in range(3)]
    errors = [run_to_end(run).stops[0].zero_error_rad for run in elbow]
    assert np.ptp(errors) < 0.3e-3
    arm, known, zeros = arm_named("as-built:2"), None, []
    for seed in (1, 2):
        found = run_to_end(prepare_homing(arm, Joint.WRIST, World(), seed=seed, reference=known))
        assert found.outcome is Outcome.DONE
        known = found.reference
        zeros.append(known.zero_rad[Joint.WRIST])
    assert zeros[0] == pytest.approx(zeros[1], abs=0.1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "temperature_C"), [(Joint.WRIST, COLD_C), (Joint.AZIMUTH, 20.0)])
def test_a_joint_that_was_left_pressed_on_its_hardstop_is_not_pressed_any_harder(joint, temperature_C):
    arm, effects = arm_named("nominal"), (Ambient(temperature_C),)
    ordinary, run = (prepare_homing(arm, joint, World(), effects=effects) for _ in range(2))
    for _ in run:
        homing = run.loop.state.move.homing if run.loop.state.move is not None else None
        if homing is not None and homing.stage is HomingStage.RETREAT:
            break
    record = run.loop.cycle((Stop(),))
    while record.outputs.joint.busy:
        record = run.loop.cycle()
    assert run.loop.state.mode is Mode.DEPLOYED
    left_Nm = run.loop.plant.stop_torque_Nm()[joint]
    assert left_Nm > 0.5 * run.loop.config.params.joints.in_order()[joint].hardstop_press_Nm
    result = run_to_end(InitialisationRun(run.loop, Calibrate(joint)))
    assert result.outcome is Outcome.DONE
    assert result.max_torque_Nm[joint] < 1.1 * run_to_end(ordinary).max_torque_Nm[joint]
    assert abs(result.stops[0].zero_error_rad) < 0.1e-3


@pytest.mark.parametrize(
    ("gain", "offset_A"),
    slow_but([(0.0, 3.5), (0.0, -3.5), (0.0, 0.0), (0.6, 0.0), (1.0, 0.5)], (0.0, 3.5), (1.0, 0.5)),
)
def test_with_a_current_sensor_that_lies_nothing_is_pressed_too_hard_or_for_ever(gain, offset_A):
    joint = Joint.TURRET
    run = prepare_homing(arm_named("nominal"), joint, World())
    sense = run.loop.avionics.sense

    def lying() -> Sensors:
        sensors = sense()
        current_A = sensors.current_A.copy()
        current_A[joint] = gain * current_A[joint] + offset_A
        return replace(sensors, current_A=current_A)

    run.loop.avionics.sense = lying
    result = run_to_end(run)
    assert result.duration_s < 120.0
    if result.outcome is Outcome.DONE:
        assert abs(result.stops[0].zero_error_rad) < 0.3e-3
    else:
        assert not result.reference.calibrated[joint]


@pytest.mark.parametrize("stage", slow_but(HomingStage, HomingStage.FINE))
def test_power_lost_half_way_leaves_nothing_half_set(stage):
    arm = arm_named("nominal")
    _, whole, _ = home_nominal(Joint.TURRET)
    times_s = [s.time_s for s in whole.samples if s.stage is stage]
    lost = (PowerLoss(float(np.median(times_s))),)
    known = whole.reference
    run = prepare_homing(arm, Joint.TURRET, World(), effects=lost, reference=known)
    result = run_to_end(run)
    assert result.outcome is Outcome.FAULTED
    assert not result.reference.calibrated[Joint.TURRET]
    assert run.loop.plant.data.eq_active[run.loop.plant.at.brake].all()
    np.testing.assert_array_equal(result.reference.half_backlash_rad, known.half_backlash_rad)


MARS, EARTH = World(), World("earth")


ARMS = {name: arm_named(name) for name in ("nominal", "m2020")}
BARE = {name: arm_check.without_turret(arm, on_earth=True) for name, arm in ARMS.items()}
PLACES = [*((arm, MARS) for arm in ARMS.values()), (BARE["nominal"], EARTH)]
EACH_PLACE = pytest.mark.parametrize(("arm", "world"), PLACES, ids=["mars", "m2020", "earth"])
EACH_ARM = pytest.mark.parametrize("name", ARMS)


@EACH_PLACE
def test_on_the_whole_way_to_every_hardstop_the_arm_is_clear_of_rover_ground_and_itself(arm, world):
    way_rad = arm_check.sweep_poses(arm_check.calibration_poses(arm.params))
    found = ClearanceModel(arm.params, world, arm.model).clearance(way_rad)
    assert min(found.outside_m, found.self_m) > 2 * arm_check.HARDSTOP_CLEARANCE_M
    stops = [joint.hardstop_rad for joint in arm.params.joints.in_order()]
    np.testing.assert_allclose(way_rad.min(axis=1), stops)


@EACH_PLACE
@pytest.mark.parametrize("joint", slow_but(Joint, Joint.ELEVATION, Joint.ELBOW))
def test_a_joint_has_room_to_run_wherever_it_is_allowed_to(joint, arm, world):
    space, most = ClearanceModel(arm.params, world, arm.model), arm.params.hardstop.pose_tolerance_rad
    rng = np.random.default_rng([15, joint])
    for pose in homing_start_poses(arm.params, joint):
        for _ in range(20):
            way = np.repeat((pose + rng.uniform(-most, most, 5))[:, None], 12, axis=1)
            way[joint] = np.linspace(arm.params.joints.in_order()[joint].hardstop_rad, way[joint, 0], 12)
            found = space.clearance(way)
            assert min(found.outside_m, found.self_m) > arm_check.HARDSTOP_CLEARANCE_M


@EACH_ARM
def test_without_a_turret_on_earth_each_joint_is_clear_at_its_hardstop(name):
    params, model = BARE[name].params, BARE[name].model
    space = ClearanceModel(params, EARTH, model)
    for joint in Joint:
        pose = homing_start_poses(params, joint)[-1].copy()
        pose[joint] = params.joints.in_order()[joint].hardstop_rad
        found = space.clearance(pose[:, None])
        assert min(found.outside_m, found.self_m) > arm_check.HARDSTOP_CLEARANCE_M


@EACH_ARM
def test_the_torques_are_the_same_on_earth_without_a_turret_and_others_in_the_poses_of_mars(name):
    in_mars_poses = arm_check.without_turret(ARMS[name], on_earth=False).params
    mars = arm_check.compute_hardstop_loads(ARMS[name].params, MARS.gravity_N_m_s2).torque_Nm
    earth, other = (
        arm_check.compute_hardstop_loads(params, EARTH.gravity_N_m_s2).torque_Nm
        for params in (BARE[name].params, in_mars_poses)
    )
    same = list(arm_check.EQUALISED_JOINTS)
    np.testing.assert_allclose(earth[same], mars[same], atol=0.5)
    if name == "nominal":
        np.testing.assert_allclose(earth, mars, atol=1.1)
        assert np.abs(other - mars).max() > 50


def test_an_arm_whose_elbow_reaches_its_limit_has_nearly_the_torques_of_mars():
    arm = arm_named("calibrated:7")
    bare = arm_check.without_turret(arm, on_earth=True).params
    elbow = bare.joints.elbow
    assert bare.hardstop.second_start_rad[Joint.ELBOW] == pytest.approx(elbow.soft_min_rad, abs=1e-3)
    mars = arm_check.compute_hardstop_loads(arm.params, MARS.gravity_N_m_s2).torque_Nm
    earth = arm_check.compute_hardstop_loads(bare, EARTH.gravity_N_m_s2).torque_Nm
    joints = bare.joints.in_order()
    shift_rad = {
        joint: abs(earth - mars)[joint] / joints[joint].gear_stiffness_Nm_rad
        for joint in arm_check.EQUALISED_JOINTS
    }
    assert max(shift_rad.values()) < arm_check.MOST_SHIFT_RAD
    assert shift_rad[Joint.ELEVATION] > 5e-6


def test_torques_that_no_pose_has_are_refused():
    with pytest.raises(arm_check.NoPlan, match="best torques differ"):
        arm_check.equalise_loads(BARE["nominal"].params, EARTH.gravity_N_m_s2, np.full(5, -2000.0))

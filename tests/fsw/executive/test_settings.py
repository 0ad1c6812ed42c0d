"""Settings by command: the tilt, and any single number of the parameters."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoint, MoveJoints, SetParam, SetTilt
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CommandCompleted, CommandRefused, ParamSet, TiltSet
from fsw.dictionary.params import digest
from tests.fsw.executive.lab import refusal
from tests.fsw.rig import MARS_R_m_s2, Rig, config_of, floats

CONFIG = config_of()


def test_a_parameter_takes_effect_and_the_digest_of_all_is_told():
    rig = Rig(CONFIG)
    rig.run(SetParam("joints.turret.speed_rad_s", 0.02))
    changed = rig.state.changed_config
    assert changed.speed_rad_s[Joint.TURRET] == 0.02
    assert digest(changed.params) == changed.params_sha256 != CONFIG.params_sha256
    told = ParamSet("joints.turret.speed_rad_s", 0.02, changed.params_sha256)
    assert rig.evrs[-2:] == [told, CommandCompleted("SetParam")]
    pose = np.array(CONFIG.params.poses.ready_rad)
    pose[Joint.TURRET] += 0.5
    rates = []
    rig.cycle(MoveJoints(floats(pose)))
    while rig.outputs.joint.busy:
        rates.append(rig.outputs.drive.setpoint_rate_rad_s[Joint.TURRET])
        rig.cycle()
    assert max(rates) == pytest.approx(0.02)


def test_two_parameters_may_be_set_one_after_the_other_or_in_the_same_cycle():
    one, other = SetParam("collision.ground_z_m", 1.3), SetParam("hardstop.moved_rad", 0.003)
    for cycles in (((one,), (other,)), ((one, other),)):
        rig = Rig(CONFIG)
        for commands in cycles:
            rig.run(*commands)
        params = rig.state.changed_config.params
        assert (params.collision.ground_z_m, params.hardstop.moved_rad) == (1.3, 0.003)


def test_a_command_in_the_cycle_of_a_new_parameter_is_checked_with_it():
    rig = Rig(CONFIG)
    most_rad = 0.5 * (CONFIG.params.poses.ready_rad[Joint.TURRET] + CONFIG.arm.soft_max_rad[Joint.TURRET])
    rig.evrs.clear()
    rig.begin(SetParam("joints.turret.soft_max_rad", most_rad), MoveJoint(Joint.TURRET, most_rad + 0.1))
    (refused,) = (evr for evr in rig.evrs if isinstance(evr, CommandRefused))
    assert "soft limits" in refused.reason


@pytest.mark.parametrize("name", ["gear_ratio", "hardstop_rad", "encoder_counts_per_turn"])
def test_a_joint_whose_zero_rests_on_a_parameter_is_to_be_calibrated_again(name):
    rig = Rig(CONFIG)
    value = getattr(CONFIG.params.joints.elbow, name)
    rig.run(SetParam(f"joints.elbow.{name}", value + (1 if name != "hardstop_rad" else 1e-3)))
    calibrated = rig.state.joints.reference.calibrated
    assert calibrated.tolist() == [joint is not Joint.ELBOW for joint in Joint]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("monitors.tilt_rd", 0.1, "monitors.tilt_rd: 'tilt_rd' is not a parameter; there are gravity_min_"),
        ("joints", 1.0, "joints: not one number; only single numbers can be set"),
        ("arm_name", 1.0, "arm_name: not one number; only single numbers can be set"),
        ("joints.elbow.speed_rad_s", 9.0, "joints.elbow.speed_rad_s: 9.0 is outside 0.001 .. 0.1"),
        ("joints.elbow.speed_rad_s", float("nan"), "value: nan is outside -1e+09 .. 1e+09"),
        ("motion.load_period_cycles", 2.5, "motion.load_period_cycles: must be a whole number, is 2.5"),
        ("joints.elbow.soft_max_rad", 1.0, "poses.ready_rad"),
        ("joints.elevation.hardstop_press_Nm", 301.0, "301.0 is above 300, 0.5 of hardstop_rated_Nm"),
    ],
)
def test_what_is_no_parameter_or_no_believable_value_is_refused(name, value, reason):
    assert reason in refusal(Rig(CONFIG), SetParam(name, value))


def test_gravity_lies_where_the_ground_says_from_then_on():
    rig = Rig(CONFIG)
    rig.run(SetTilt(0.005, -0.003))
    gravity = rig.state.joints.gravity_R_m_s2
    assert np.linalg.norm(gravity) == pytest.approx(3.711)
    # right side down: gravity has a component to the right; nose down: a component forward
    np.testing.assert_allclose(gravity / 3.711, [0.003, 0.005, 1.0], atol=2e-5)
    np.testing.assert_allclose(rig.state.joints.imu_R_m_s2, MARS_R_m_s2, atol=1e-9)
    differences_rad = [evr.difference_rad for evr in rig.evrs if isinstance(evr, TiltSet)]
    assert pytest.approx(0.00583, abs=1e-5) in differences_rad


@pytest.mark.parametrize("tilt", [(0.02, 0.0), (float("nan"), 0.0), (0.0, float("inf")), (3.0, 0.0)])
def test_a_tilt_that_the_imu_does_not_confirm_is_refused(tilt):
    assert refusal(Rig(CONFIG), SetTilt(*tilt))

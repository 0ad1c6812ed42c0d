"""Whatever the sensors say, set-points stay finite and inside the limits, and nothing is raised."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.dictionary.commands import ClearFault, MoveJoints, Retract, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Evr
from tests.fsw.rig import MARS_R_m_s2, Rig, config_of, facing, floats, in_limits
from tests.tools import TOOLS

CONFIG = config_of()
CYCLES = 150
JITTER_RAD = 1e-3


def readings(rng, rig, trouble):
    """One cycle of sensors: mostly noise, sometimes a storm, sometimes no number at all."""
    jitter = rng.uniform(-JITTER_RAD, JITTER_RAD, 5) / CONFIG.rad_per_count
    values = {
        "encoder_count": rig.count + np.rint(jitter).astype(int),
        "resolver_rad": rig.resolver_rad() + rng.normal(0, 1e-3, 5),
        "current_A": rng.normal(0, 1.0, 5),
        "winding_C": rng.uniform(-130, 80, 5),
        "switch_closed": rng.random(10) < 0.02 * trouble,
        "gravity_R_m_s2": MARS_R_m_s2 + rng.normal(0, 0.5, 3),
    }
    if rng.random() < 0.05 * trouble:
        name = rng.choice(["resolver_rad", "current_A", "winding_C", "gravity_R_m_s2"])
        values[name][rng.integers(values[name].size)] = rng.choice([np.nan, np.inf])
    if rng.random() < 0.1 * trouble:
        values["current_A"] = rng.uniform(-1e3, 1e3, 5)
    if rng.random() < 0.1 * trouble:
        values["resolver_rad"] = rng.uniform(-7, 7, 5)
    return values


def command(rng, rig):
    kind = rng.integers(6)
    if kind == 0:
        return Stop()
    if kind == 1:
        return ClearFault()
    if kind == 2:
        return Retract(TOOLS[rng.integers(5)], rng.uniform(0, 0.3))
    if kind == 3:
        return rig.touch(TOOLS[rng.integers(5)], rng.uniform(0.001, 0.3))
    if kind == 4:
        return rig.here(TOOLS[rng.integers(5)], rng.uniform(-0.3, 0.3))
    return MoveJoints(floats(in_limits(CONFIG, rng, 1)[:, 0]))


def assert_safe(rig):
    drive, joint = rig.outputs.drive, rig.outputs.joint
    setpoint = drive.setpoint_count * CONFIG.rad_per_count + rig.state.joints.reference.zero_rad
    room = CONFIG.params.monitors.soft_limit_margin_rad + JITTER_RAD
    if drive.power_on.any():
        assert (setpoint >= CONFIG.arm.soft_min_rad - room).all()
        assert (setpoint <= CONFIG.arm.soft_max_rad + room).all()
    assert (np.abs(drive.setpoint_rate_rad_s) <= 1.5 * CONFIG.speed_rad_s).all()
    np.testing.assert_array_equal(drive.current_limit_A, CONFIG.current_limit_A)
    for values in (drive.setpoint_rate_rad_s, joint.motor_rad, joint.motor_rate_rad_s, joint.setpoint_rad):
        assert np.isfinite(values).all()
    assert np.isfinite(joint.backlash_rad).all()
    assert not (drive.brake_release & ~drive.power_on).any()
    if joint.mode is Mode.FAULTED:
        assert not drive.brake_release.any()
        assert not drive.setpoint_rate_rad_s.any()
    if rig.outputs.tool is not None:
        for values in (rig.outputs.tool.p_RoTo_R_m, rig.outputs.tool.R_RT, rig.outputs.tool.load_torque_Nm):
            assert np.isfinite(values).all()
    for evr in rig.outputs.evrs:
        assert isinstance(evr, Evr)
        assert "nan" not in evr.message


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 1.0]))
def test_random_sensors_and_commands_never_make_the_arm_unsafe(seed, trouble):
    rng = np.random.default_rng(seed)
    start = facing(CONFIG, "apxs") if rng.random() < 0.5 else in_limits(CONFIG, rng, 1)[:, 0]
    rig = Rig(CONFIG, Mode(rng.integers(2)), start)
    for _ in range(CYCLES):
        commands = (command(rng, rig),) if rng.random() < 0.06 else ()
        rig.cycle(*commands, **readings(rng, rig, trouble))
        assert_safe(rig)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_a_stuck_or_slipping_arm_never_makes_its_set_points_run_away(seed):
    rng = np.random.default_rng(seed)
    rig = Rig(CONFIG, start_rad=in_limits(CONFIG, rng, 1, shrink=0.2)[:, 0])
    rig.stuck = True
    rig.cycle(MoveJoints(floats(in_limits(CONFIG, rng, 1)[:, 0])))
    for _ in range(CYCLES):
        rig.count = rig.count + rng.integers(-30, 31, 5)
        rig.cycle()
        assert_safe(rig)


def test_one_wild_encoder_reading_does_not_become_a_set_point_under_power():
    rig = Rig(CONFIG)
    rig.until_moving(MoveJoints(floats(np.array(CONFIG.params.poses.ready_rad) + 0.05)))
    before = rig.outputs.drive.setpoint_count
    drive = rig.cycle(encoder_count=rig.count + 10**7).drive
    assert drive.power_on.all()
    # no farther than a motor may follow
    bound = np.ceil(CONFIG.params.monitors.following_error_rad / CONFIG.rad_per_count)
    assert (np.abs(drive.setpoint_count - before) <= bound).all()


@pytest.mark.parametrize("wild_m_s2", [0.0, 0.99, 20.1, 1e6, 1e200])
def test_one_wild_but_finite_gravity_reading_is_survived(wild_m_s2):
    rig = Rig(CONFIG)
    rig.cycle(gravity_R_m_s2=[0.0, 0.0, wild_m_s2])
    for _ in range(64):
        rig.cycle()
    assert np.isfinite(rig.state.joints.backlash_state).all()
    assert np.isfinite(rig.state.load.torque_Nm).all()

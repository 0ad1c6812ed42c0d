"""The nominal model follows logs of its own kind, and says where it blows up."""

from dataclasses import replace

import numpy as np

from helpers.planar_arm import COUNT_RAD, commands, planar_arm, record
from simgap.checks.audit import NominalModel
from simgap.logs import Signal


def test_the_model_repeats_what_it_recorded_to_a_count():
    motion = record(planar_arm(), 1, commands(1, -0.6, 0.4))
    found = NominalModel(planar_arm()).simulate(motion)
    assert max(found.mean_abs_rad.values()) < COUNT_RAD


def test_a_motor_that_is_off_lets_the_arm_fall():
    motion = record(planar_arm(), 1, commands(1, -0.6, 0.4))
    shoulder = motion.joints["shoulder"]
    time_s = shoulder.position.time_s
    off = replace(shoulder, enabled=Signal(time_s, (time_s < 6.0).astype(float)))
    found = NominalModel(planar_arm()).simulate(replace(motion, joints={**motion.joints, "shoulder": off}))
    error = np.abs(found.position["shoulder"] - shoulder.position.value)
    assert error[time_s < 6.0].max() < 0.05
    assert error[time_s > 7.0].max() > 0.5


def test_a_simulation_that_blows_up_has_no_error():
    robot = planar_arm()
    stiff = replace(robot, joints=tuple(replace(one, kp_Nm_rad=1e12) for one in robot.joints))
    motion = record(robot, 1, commands(1, -0.6, 0.4))
    found = NominalModel(
        replace(stiff, joints=tuple(replace(o, torque_limit_Nm=np.inf) for o in stiff.joints))
    )
    assert np.isnan(found.simulate(motion).mean_abs_rad["shoulder"])

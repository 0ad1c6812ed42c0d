"""The compiled models: stages of a step that are switched off must change nothing."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from helpers.pendulum import pendulum
from helpers.real_robots import robot_path
from helpers.two_joint_arm import arm
from simgap.arrays import Array
from simgap.robot import Robot
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import profiler_off

IDLE = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ISLAND


def path(model: mujoco.MjModel) -> Array:
    """Swing all joints far, into their limits if they have some."""
    data = mujoco.MjData(model)
    found = []
    for k in range(500):
        data.qfrc_applied[:] = 5.0 * np.sin(0.02 * k + np.arange(model.nv))
        mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    return np.array(found)


def so101() -> Robot:
    return Robot.from_toml(robot_path("so101"))


@pytest.mark.parametrize("robot", [pendulum, arm, so101])
def test_the_stages_that_are_skipped_change_no_bit(robot: Callable[[], Robot]) -> None:
    model = Models(robot()).compiled([]).robot.model
    assert model.opt.disableflags & IDLE == IDLE
    fast = path(model)
    model.opt.disableflags &= ~IDLE
    assert np.array_equal(fast, path(model))


def test_the_profiler_is_off_inside_and_on_again_outside() -> None:
    mujoco.set_mjcb_time(None)  # a plant in this process has switched it off for good
    model = pendulum().model
    seconds = []
    with profiler_off():
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data)
        seconds.append(data.timer[0].duration)
    mujoco.mj_step(model, data)
    seconds.append(data.timer[0].duration)
    assert seconds[0] == 0.0 < seconds[1]

"""A real XL330 servo that swings a pendulum: three effects predict a gain that took no part."""

import pytest

from helpers.real_robots import robot_path
from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.robot import Robot

pytestmark = [pytest.mark.real_data, pytest.mark.slow]


def test_three_effects_predict_the_gain_that_was_held_out(real_data):
    robot = Robot.from_toml(robot_path("pendulum"))
    logs = load(robot, [real_data / "xl330" / "xl330.parquet"])
    result = diagnose(robot, logs.fit, held_out=logs.judged, seed=1)
    (error,) = result.errors
    assert {motion.condition for motion in logs.judged} == {"400"}
    assert error.explained < 0.040 < error.base
    assert len(result.findings) <= 3
    assert "load-dependent friction" in {one.effect for one in result.findings}

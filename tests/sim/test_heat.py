"""Growth of the arm with its temperature, and its compensation by flight software."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import configure, configure_at
from fsw.kinematics.chain import forward, tool_pose
from marsarm.accuracy.trial import configure_true
from sim.arms import arm_named
from sim.effects.effect import Effect
from sim.effects.environment import Ambient
from sim.effects.geometry import Expansion
from sim.effects.sensors import StructureSensor
from sim.tolerances import list_frames
from tests.sim.effects import bench

NOMINAL = arm_named("nominal")
CONFIG = configure(NOMINAL.params)
HALF = tuple(Expansion(frame, 0.5, tool) for frame, tool in list_frames(NOMINAL.params.tool_names))
POSES = 40
"""Poses of each of the five tools."""


def growth_errors_m(warming_K: float, compensated_share: float, *effects: Effect) -> np.ndarray:
    """Compare the tools of MuJoCo with those of flight software at equal joint angles, undeflected."""
    warm_C = CONFIG.params.heat.calibration_C + warming_K
    plant, hardware = bench.build_arm(*effects, Ambient(warm_C))
    heat = replace(CONFIG.params.heat, compensated_share=compensated_share)
    believed = configure_at(
        configure(replace(NOMINAL.params, heat=heat)), hardware.structure_C + hardware.structure_offset_K
    )
    rng, found = np.random.default_rng(7), []
    for _ in range(POSES):
        pose_rad = rng.uniform(CONFIG.arm.soft_min_rad, CONFIG.arm.soft_max_rad)
        true_m = bench.set_angles(plant, pose_rad).truth().p_RoTo_R_m
        frames = forward(believed.arm, pose_rad)
        believed_m = np.array([tool_pose(believed.arm, frames, tool).p for tool in plant.tools])
        found.append(np.linalg.norm(true_m - believed_m, axis=1))
    return np.concatenate(found)


@pytest.mark.parametrize("warming_K", [-75.0, 30.0])
def test_flight_software_compensates_the_growth_of_the_arm(warming_K: float) -> None:
    left_m, off_m = growth_errors_m(warming_K, 1.0), growth_errors_m(warming_K, 0.0)
    assert left_m.size == 200
    assert left_m.max() < 0.02e-3
    assert np.median(off_m) > 0.02e-3 * abs(warming_K)


def test_a_sensor_that_reads_a_kelvin_too_much_costs_what_the_arm_grows_in_a_kelvin() -> None:
    offset_m = growth_errors_m(0.0, 1.0, StructureSensor(1.0))
    np.testing.assert_allclose(offset_m, growth_errors_m(1.0, 0.0), rtol=1e-3)


def test_what_statics_know_of_an_arm_has_its_temperature_and_coefficients() -> None:
    warmed = configure_at(CONFIG, CONFIG.params.heat.calibration_C + 0.5 * 30.0).arm
    true = configure_true(replace(NOMINAL, effects=(*HALF, Ambient(50.0)))).arm
    pose_rad = np.array(NOMINAL.params.poses.ready_rad)
    for tool in NOMINAL.params.tool_names:
        one, other = (tool_pose(arm, forward(arm, pose_rad), tool) for arm in (true, warmed))
        np.testing.assert_allclose(one.p, other.p, atol=1e-6)

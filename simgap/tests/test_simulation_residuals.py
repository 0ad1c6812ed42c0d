"""Starts of windows, and the error of the time step."""

import numpy as np
import pytest

from helpers.pendulum import motion, pendulum, simulated, waves
from simgap.arrays import Array
from simgap.residuals.simulation_residuals import SimulationResiduals

TIME_s = np.arange(0.0, 2.0, 0.01)
NOISE_rad = 1e-4
FINE = pendulum(step_s=0.00025)


def measure(position_rad: Array, seed: int) -> Array:
    """Add the noise of an encoder."""
    return position_rad + NOISE_rad * np.random.default_rng(seed).standard_normal(position_rad.size)


def worst_residual(step_s: float, measured_rad: Array, command: Array) -> float:
    robot = pendulum(step_s=step_s, period_s=0.004)
    model = SimulationResiduals(robot, [motion(TIME_s, measured_rad, command)], n_threads=1)
    return float(np.abs(model.residuals([], np.zeros((1, 0)))).max())


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_that_is_pulled_from_rest_starts_at_rest(seed: int) -> None:
    command = np.full(TIME_s.size, 0.5)
    truth = simulated(FINE, motion(TIME_s, 0 * TIME_s, command))
    speed_rad_s = truth[4] / TIME_s[4]
    assert speed_rad_s > 0.5  # the speed of its first samples
    assert worst_residual(0.002, measure(truth, seed), command) < 10 * NOISE_rad


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_whose_log_begins_in_motion_starts_with_its_speed(seed: int) -> None:
    command = waves(TIME_s, seed)
    truth = simulated(FINE, motion(TIME_s, 0 * TIME_s, command))
    speed_rad_s = np.gradient(truth, TIME_s)
    begin = int(np.argmax(speed_rad_s[:100]))
    log = motion(TIME_s[begin:], measure(truth, seed)[begin:], command[begin:])
    model = SimulationResiduals(pendulum(), [log], n_threads=1)
    assert np.abs(model.residuals([], np.zeros((1, 0)))).max() < 20 * NOISE_rad


def test_steps_that_are_too_long_for_the_motor_show_no_residual() -> None:
    command = waves(TIME_s, 5)
    truth = simulated(FINE, motion(TIME_s, 0 * TIME_s, command))
    long = np.abs(simulated(pendulum(step_s=0.004, period_s=0.004), motion(TIME_s, truth, command)) - truth)
    assert worst_residual(0.004, truth, command) < 0.2 * long.max()


@pytest.mark.parametrize("seed", range(3))
def test_a_start_that_is_measured_wrongly_leaves_nothing_in_a_fit(seed: int) -> None:
    command = waves(TIME_s, seed)
    truth = simulated(FINE, motion(TIME_s, 0 * TIME_s, command))
    measured_rad = measure(truth, seed)
    measured_rad[:5] += 5e-3
    log = motion(TIME_s, measured_rad, command)
    judged, fitted = (
        np.abs(
            SimulationResiduals(pendulum(), [log], n_threads=1, fit_starts=fit).residuals(
                [], np.zeros((1, 0))
            )
        )
        for fit in (False, True)
    )
    assert judged[0, 5:15].max() > 10 * NOISE_rad
    assert np.median(fitted[0, 5:]) < 2 * NOISE_rad

"""The simulator of the synthetic truth: energy, friction, delays, limits, noise, convergence."""

from functools import cache

import numpy as np
import pytest

from helpers.marks import slow_but
from validation.cases import robot_inside as inside
from validation.cases import robot_setup
from validation.cases.robot_draw import measure
from validation.cases.robot_table import ENTRIES, OUTSIDE, list_hypotheses
from validation.cases.robot_truth import Nuisances, Plant, Scene

PENDULUM = robot_setup.load_robot("pendulum")
PLAN = robot_setup.draw_plan(PENDULUM, np.random.default_rng(5))
WEIGHT_NM = 9.81 * (0.5 * 0.12 + 0.05 * 0.07)
"""Largest torque of gravity: bob at 0.12 m and rod at half of 0.14 m."""
NO_NUISANCES = Nuisances(*np.ones((4, 1)))


def free_pendulum(friction_Nm):
    off = np.zeros(1)
    nuisances = Nuisances(off, off, np.ones(1), off)
    effects = [inside.Coulomb(PLAN.scene, "swing", friction_Nm)] if friction_Nm else []
    return Plant(PENDULUM, nuisances, effects)


def held(angle_rad, samples=200):
    return np.full((1, samples), angle_rad)


def simulate(effects, samples=150):
    plant = Plant(PENDULUM, NO_NUISANCES, effects)
    return plant.simulate(PLAN.commands[0][:, :samples], robot_setup.PERIOD_S, 1)[0]


def test_a_free_pendulum_keeps_its_energy():
    shown = free_pendulum(0.0).simulate(held(0.8, 400), robot_setup.PERIOD_S, 1)[0]
    assert np.abs(shown).max() == pytest.approx(0.8, abs=2e-3)


@pytest.mark.parametrize(("share", "moves"), [(1.02, False), (0.98, True)])
def test_dry_friction_holds_up_to_its_torque(share, moves):
    angle_rad = 0.6
    pendulum = free_pendulum(share * WEIGHT_NM * np.sin(angle_rad))
    shown = pendulum.simulate(held(angle_rad), robot_setup.PERIOD_S, 1)[0]
    assert (np.abs(shown - angle_rad).max() > 1e-3) == moves


@pytest.mark.parametrize("kind", [inside.CommandDelay, inside.MeasurementDelay])
def test_a_delay_of_two_samples_shifts_the_log_by_two(kind):
    late, on_time = simulate([kind(PLAN.scene, "swing", 2 * robot_setup.PERIOD_S)]), simulate([])
    assert late[2:] == pytest.approx(on_time[:-2], abs=1e-9)


def test_a_command_delay_below_the_step_is_not_lost():
    on_time = simulate([])
    small, large = (simulate([inside.CommandDelay(PLAN.scene, "swing", s)]) for s in (5e-5, 1e-4))
    assert np.linalg.norm(large - on_time) == pytest.approx(2 * np.linalg.norm(small - on_time), rel=0.05)


def test_a_position_is_not_shown_past_a_clamped_command():
    stiff = Nuisances(np.ones(1), np.zeros(1), np.ones(1), 20.0 * np.ones(1))
    clamp = inside.ClampHigh(PLAN.scene, "swing", 0.3)
    end_rad = PLAN.scene.high_rad[0] - 0.3
    plant = Plant(PENDULUM, stiff, [clamp])
    shown = plant.simulate(held(PLAN.scene.high_rad[0], 50), robot_setup.PERIOD_S, 1)[0]
    assert shown[-1] == pytest.approx(end_rad, abs=0.01)


def test_compliance_moves_the_motor_and_not_the_joint_at_rest():
    plant = Plant(PENDULUM, NO_NUISANCES, [inside.Compliance(PLAN.scene, "swing", 0.02)])
    without = Plant(PENDULUM, NO_NUISANCES, [])
    both = [one.simulate(held(0.8, 50), robot_setup.PERIOD_S, 1)[0, -1] for one in (plant, without)]
    # the encoder is at the joint: dry friction may hold the two at different angles, 0.06 N m of 12 N m/rad
    assert both[0] == pytest.approx(both[1], abs=0.06 / 12)


WAVES_AND_JUMP = np.concatenate([PLAN.commands[4][:, :150], PLAN.commands[0][:, :100]], axis=1)
"""Commands of waves and then of a jump, at which the torque is limited."""
HYPOTHESES = list_hypotheses(robot_setup.load_robot("pendulum"), ENTRIES + OUTSIDE)


@cache
def simulate_warm(*effects):
    plant = Plant(PENDULUM, NO_NUISANCES, list(effects), 0.001)
    return plant.simulate(WAVES_AND_JUMP, robot_setup.PERIOD_S, 3, (25.0, 30.0))


@pytest.mark.parametrize("one", slow_but(HYPOTHESES, *HYPOTHESES[::3]), ids=[one.key for one in HYPOTHESES])
def test_every_effect_moves_the_log_and_none_diverges(one):
    scene = Scene(PENDULUM, (float(WAVES_AND_JUMP.min()),), (float(WAVES_AND_JUMP.max()),), 0.0)
    effect = one.entry.kind(scene, one.place, one.entry.typical * one.scale, 0.3)
    assert np.abs(simulate_warm(effect) - simulate_warm()).max() > 1e-6


def test_a_quarter_of_the_step_moves_the_samples_by_less_than_a_tenth_of_the_noise():
    fine = Plant(PENDULUM, NO_NUISANCES, [], 0.0000625)
    commands = PLAN.commands[0][:, :150]
    change = simulate([]) - fine.simulate(commands, robot_setup.PERIOD_S, 1)[0]
    assert np.sqrt(np.mean(change**2)) < 0.1 * robot_setup.NOISE_RAD


def test_the_noise_has_the_stated_size_correlation_and_quantum():
    # a slow ramp, so that the rounding is not always the same
    truth = np.linspace(0.0, 1.0, 50_000)[None]
    shown = measure(truth, np.random.default_rng(1))
    noise = (shown - truth)[0]
    assert noise.std() == pytest.approx(robot_setup.LOG_SD_RAD, rel=0.03)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(robot_setup.LOG_CORRELATION, abs=0.02)
    counts = shown / robot_setup.QUANTUM_RAD
    assert counts == pytest.approx(np.round(counts), abs=1e-6)
    assert robot_setup.whiten(noise).std() == pytest.approx(1.0, rel=0.03)


def test_the_limit_has_its_power_and_its_false_alarms():
    motions, hypotheses = 8, 50
    shift = robot_setup.limit_noncentrality(motions, hypotheses)
    rng = np.random.default_rng(2)
    scores = rng.standard_normal((200_000, motions)) + shift / np.sqrt(motions)
    t = np.sqrt(motions) * scores.mean(axis=1) / scores.std(axis=1, ddof=1)
    nothing = rng.standard_t(motions - 1, 2_000_000)
    threshold = np.quantile(t, 0.1)
    assert np.mean(np.abs(nothing) > threshold) * hypotheses == pytest.approx(0.05, rel=0.15)

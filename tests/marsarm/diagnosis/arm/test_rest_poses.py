"""Rests without dynamics, the error of the tool from them, and every candidate at both ends of its sizes."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from fsw.config import configure
from fsw.dictionary.enums import Frame, Joint
from fsw.kinematics.statics import settle_output
from marsarm.diagnosis.arm.arm_effects import list_hypotheses
from marsarm.diagnosis.arm.case import compute_tool_error
from marsarm.diagnosis.arm.feature_set import FeatureSet, build_feature_set, rests_moved_by, simulate_features
from marsarm.diagnosis.arm.features import RESOLVER
from marsarm.diagnosis.arm.logs import Recording
from marsarm.diagnosis.arm.rest_poses import creep_shares, simulate_open_loop
from sim.arms import nominal_params
from sim.effects.joints import BusSag
from sim.effects.sensors import CounterStart
from sim.effects.structure import LinkCreep
from sim.plant import SCREW_AXES


@pytest.fixture(scope="module")
def features(recordings: list[Recording]) -> FeatureSet:
    """Return the features of the rests of a session with poses."""
    return build_feature_set(recordings[:1])


def test_under_a_constant_load_a_link_creeps_exponentially():
    time_s = np.array([0.5, 3.0, 20.0])
    shares = creep_shares(time_s, np.tile([[0.0], [2e-3], [0.0]], 3), creep_s=5.0)
    np.testing.assert_allclose(shares, 1.0 - np.exp(-time_s / 5.0), rtol=1e-12)


def test_under_a_changing_load_a_link_follows_its_differential_equation():
    """Oracle: small steps in time."""
    time_s, whole = np.array([1.0, 4.0, 6.0]), np.array([1e-3, -2e-3, 3e-3])
    a, step_s, found = 0.0, 5e-4, []
    for now_s in np.arange(0.0, 6.0, step_s):
        load = np.interp(now_s, time_s, whole)
        a += step_s * (load - a) / 2.0
        found += [a] if np.min(np.abs(time_s - now_s - step_s)) < step_s / 2 else []
    shares = creep_shares(time_s, np.stack([0 * whole, whole, 0 * whole]), creep_s=2.0)
    np.testing.assert_allclose(shares * whole, found, rtol=1e-3)


@pytest.mark.slow
def test_a_creeping_link_rests_where_the_plant_does(features):
    """Oracle: the plant, stepped under the recorded drive, with the effect and without."""
    (one,) = features.rests
    at, effect = one.turning_points, LinkCreep(Frame.ARM3, "y", 2e-5)
    ticks = [at.tick[k] for k in at.rests]
    with_it, without = (
        simulate_open_loop(at.recording, effects, frozenset(ticks))[1] for effects in ((effect,), ())
    )
    after, before = (simulate_features(features, some) for some in ((effect,), ()))
    shift = (after - before)[-3 * len(one.tracked) :].reshape(3, -1)
    for column, rest in zip(shift.T, one.tracked, strict=True):
        stepped = without[ticks[rest]].R.T @ (with_it[ticks[rest]].p - without[ticks[rest]].p)
        np.testing.assert_allclose(column, stepped, atol=0.03 * np.linalg.norm(stepped))


def test_a_joint_that_was_turned_moves_its_resolver_and_the_poses(features):
    """Oracle: kinematics at the turned angle; all other joints were turned too."""
    (one,) = features.rests
    config, by_rad = configure(nominal_params()), 1e-5
    gravity = one.turning_points.recording.world.gravity_N_m_s2
    motor_rad = one.turning_points.motor_rad[:, [one.turning_points.rests[r] for r in one.tracked]]
    change = np.array([by_rad * (feature.channel == RESOLVER) for feature in one.features])
    for joint in Joint:
        turned = motor_rad + by_rad * (np.arange(len(Joint)) == joint)[:, None]
        before, after = (settle_output(config.arm, at, gravity).frames.X_RF[5] for at in (motor_rad, turned))
        found = rests_moved_by(features, change, joint)
        shift = found[-3 * motor_rad.shape[1] :].reshape(3, -1)
        expected = np.einsum("kin,kn->in", before.R, after.p - before.p)
        np.testing.assert_allclose(shift, expected, atol=0.02 * by_rad)
        own = [
            one.channel == RESOLVER and one.place == joint.name.lower() for one in features.rests[0].features
        ]
        read, resolvers = rests_moved_by(features, change, joint, turns=False), change != 0.0
        np.testing.assert_array_equal(read, np.where(own, by_rad, 0.0))
        np.testing.assert_array_equal(found[resolvers], read[resolvers])


DRAWING = nominal_params()
KEYS = [f"poses/rest 0/{axis}" for axis in reversed(SCREW_AXES)] + ["poses/rest 1/rx", "poses/rest 0/elbow"]


def off(**screw: float) -> np.ndarray:
    return np.array([screw.get(key.rpartition("/")[2], 0.0) for key in KEYS])


def test_a_shift_moves_every_tool_by_as_much():
    rows = [off(tx=3e-3, ty=4e-3), off(tx=3e-3), off(tz=1e-3)]
    found = compute_tool_error(KEYS, rows, off(tx=2e-3), DRAWING)
    assert found is not None
    assert (found.nominal, found.base, found.explained) == pytest.approx((5e-3, 3e-3, 1e-3))
    assert found.noise_floor == pytest.approx(2e-3)
    assert compute_tool_error(KEYS[1:], np.zeros((3, len(KEYS) - 1)), off(), DRAWING) is None


def test_a_turn_moves_a_tool_by_its_way_from_the_axis():
    found = compute_tool_error(KEYS, [off(rz=1e-3), off(rz=1e-3, tx=1e-3), off()], off(rz=1e-3), DRAWING)
    assert found is not None
    p = np.array([X.p for X in configure(DRAWING).arm.X_FT.values()])
    away = 1e-3 * np.sqrt(np.mean(p[:, 0] ** 2 + p[:, 1] ** 2))
    with_shift = 1e-3 * np.sqrt(np.mean((1.0 - p[:, 1]) ** 2 + p[:, 0] ** 2))
    assert (found.nominal, found.base, found.noise_floor) == pytest.approx((away, with_shift, away))


def candidates_at_ends() -> Iterator[Any]:
    """Yield each kind of candidate at its first place, with its least and with its greatest sizes."""
    for one in {candidate.name: candidate for candidate in list_hypotheses()}.values():
        ends = np.transpose([parameter.departure_range for parameter in one.parameters])
        for end, departures in zip(("least", "most"), ends, strict=True):
            yield pytest.param(one.switch_on(departures), id=f"{one.key}, {end}")


@pytest.mark.slow
@pytest.mark.parametrize("effect", list(candidates_at_ends()))
def test_the_simulator_carries_it(features, effect):
    assert np.all(np.isfinite(simulate_features(features, (effect,))))


def test_two_sagging_buses_leave_servos_without_power_not_with_negative_gains(features):
    assert np.all(np.isfinite(simulate_features(features, (BusSag(5.0), BusSag(5.0)))))


def test_where_a_counter_started_before_homing_changes_nothing(features):
    found = simulate_features(features, (CounterStart(Joint.ELBOW, 1.0),))
    np.testing.assert_array_equal(found, simulate_features(features, ()))

"""Rests without dynamics: a link that creeps, and joints that were turned together."""

import numpy as np
import pytest

from fsw.config import configure
from fsw.dictionary.enums import Frame, Joint
from fsw.kinematics.statics import settle_output
from marsarm.diagnosis.arm.case_simulator import SHORT_SETTLING
from marsarm.diagnosis.arm.feature_set import FeatureSet, build_feature_set, rests_moved_by, simulate_features
from marsarm.diagnosis.arm.features import RESOLVER
from marsarm.diagnosis.arm.logs import Recording
from marsarm.diagnosis.arm.rest_poses import creep_shares, simulate_open_loop
from sim.arms import nominal_params
from sim.effects.structure import LinkCreep


@pytest.fixture(scope="module")
def rests(recordings: list[Recording]) -> FeatureSet:
    """Features of the rests of a session with poses."""
    whole = build_feature_set([one for one in recordings if one.tracker_poses.tick.size][:1])
    return FeatureSet((), whole.rests)


def test_under_a_constant_load_a_link_creeps_exponentially() -> None:
    time_s = np.array([0.5, 3.0, 20.0])
    shares = creep_shares(time_s, np.tile([[0.0], [2e-3], [0.0]], 3), creep_s=5.0)
    np.testing.assert_allclose(shares, 1.0 - np.exp(-time_s / 5.0), rtol=1e-12)


def test_under_a_changing_load_a_link_follows_its_differential_equation() -> None:
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
def test_a_creeping_link_rests_where_the_plant_does(rests: FeatureSet) -> None:
    """Oracle: the plant, stepped under the recorded drive, with the effect and without."""
    (one,) = rests.rests
    recording, effect = one.turning_points.recording, LinkCreep(Frame.ARM3, "y", 2e-5)
    ticks = [one.turning_points.tick[k] for k in one.turning_points.rests]
    with_it, without = (
        simulate_open_loop(recording, effects, SHORT_SETTLING, frozenset(ticks)).X_RF
        for effects in ((effect,), ())
    )
    change = simulate_features(rests, (effect,), SHORT_SETTLING) - simulate_features(
        rests, (), SHORT_SETTLING
    )
    shift = change[-3 * len(one.tracked) :].reshape(3, -1)
    for column, rest in zip(shift.T, one.tracked, strict=True):
        stepped = without[ticks[rest]].R.T @ (with_it[ticks[rest]].p - without[ticks[rest]].p)
        np.testing.assert_allclose(column, stepped, atol=0.03 * np.linalg.norm(stepped))


def test_a_joint_that_was_turned_moves_its_resolver_and_the_poses(rests: FeatureSet) -> None:
    """Oracle: kinematics at the turned angle; all other joints were turned too."""
    (one,) = rests.rests
    config, by_rad = configure(nominal_params()), 1e-5
    gravity = one.turning_points.recording.world.gravity_N_m_s2
    motor_rad = one.turning_points.motor_rad[:, [one.turning_points.rests[r] for r in one.tracked]]
    change = np.array([by_rad * (feature.channel == RESOLVER) for feature in one.features])
    for joint in Joint:
        turned = motor_rad + by_rad * (np.arange(len(Joint)) == joint)[:, None]
        before, after = (settle_output(config.arm, at, gravity).frames.X_RF[5] for at in (motor_rad, turned))
        found = rests_moved_by(rests, change, joint)
        shift = found[-3 * motor_rad.shape[1] :].reshape(3, -1)
        expected = np.einsum("kin,kn->in", before.R, after.p - before.p)
        np.testing.assert_allclose(shift, expected, atol=0.02 * by_rad)
        places = np.array([feature.place for feature in one.features])
        resolvers = np.array([feature.channel == RESOLVER for feature in one.features])
        own = places == joint.name.lower()
        assert np.all(found[resolvers & own] == by_rad)
        assert not np.any(found[resolvers & ~own])
        read = rests_moved_by(rests, change, joint, turns=False)
        np.testing.assert_array_equal(read, np.where(resolvers & own, by_rad, 0.0))

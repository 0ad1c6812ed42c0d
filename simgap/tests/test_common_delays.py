"""Delays that all joints have in common, on a small arm whose joints move one another."""

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, motion_of, robot_of, simulate
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.effects.effect import Family
from simgap.logs import Logs
from simgap.patch.patch import make_patch
from simgap.patch.text import read_effect
from simgap.residuals.simulation_residuals import list_kinds
from simgap.selection.selection import select_effects
from simgap.selection.verdict import find_confidence_sets, list_members

ARM = robot_of(ARM_XML)
TRUTH = robot_of(ARM_XML.replace('timestep="0.001"', 'timestep="0.000125"'))
TRUTH = replace(TRUTH, control_period_s=ARM.control_period_s)
"""The same arm in steps that are short beside any delay."""
REST_S, MOVING_S, DELAY_S, NOISE_RAD = 0.8, 1.2, 0.02, 2e-4
N_REST, N_TICKS = (round(one / ARM.control_period_s) for one in (REST_S, REST_S + MOVING_S))
COMMON = ("all joints: command delay", "all joints: measurement delay")


def commands(seed):
    """Return commands of a motion that begins at rest, (n_ticks, n_joints)."""
    rng, time_s = np.random.default_rng(seed), ARM.control_period_s * np.arange(N_TICKS)
    angular, size = rng.uniform(3.0, 12.0, (2, 3)), rng.uniform(0.1, 0.3, (2, 3))
    waves = size[:, None] * (1.0 - np.cos(angular[:, None] * np.maximum(time_s - REST_S, 0.0)[:, None]))
    return np.asarray(waves.sum(axis=0))


def logs_with(effects, sizes):
    """Simulate motions with these effects; the last one repeats that before it."""
    rng, motions = np.random.default_rng(1), []
    for k in range(6):
        command = commands(min(k, 4))
        (shown,) = simulate(TRUTH, effects, [sizes], command, command[0])
        noise = NOISE_RAD * rng.standard_normal(shown.shape)
        time_s, shown = ARM.control_period_s * np.arange(N_TICKS - N_REST), (shown + noise).T[N_REST:]
        motions.append(motion_of(ARM, time_s, shown, command[N_REST:], f"m{k}", "r" if k > 3 else ""))
    return Logs(tuple(motions))


@cache
def delays():
    """Return all delays, by key."""
    return {one.key: one for one in catalogue(ARM, logs_with([], [])) if one.name.endswith(" delay")}


def findings(logs, effects):
    """Return the sets of the findings among these effects, the best first."""
    (kind,) = list_kinds(ARM, logs.fit, None)
    selection = select_effects(kind.make(logs.fit, False), base_effects(ARM, logs), effects, seed=1)
    return [list_members(one)[2] for one in find_confidence_sets(selection)]


def own(common):
    """Return the delays of this kind at each joint."""
    return [one for one in delays().values() if one.name == delays()[common].name and one.key != common]


def test_a_delay_of_all_joints_acts_as_one_at_each():
    command = commands(0)
    for n_periods, key in ((4.0, COMMON[0]), (0.4, COMMON[1]), (3.7, COMMON[1]), (-1.3, COMMON[1])):
        assert delays()[key].family == Family.TIMING
        delay_s, sets = n_periods * ARM.control_period_s, ([delays()[key]], own(key))
        one, each = (simulate(ARM, some, [[delay_s] * len(some)], command, command[0]) for some in sets)
        np.testing.assert_allclose(one[..., N_REST:], each[..., N_REST:], atol=1e-6)


def test_a_patch_has_the_delay_of_each_joint():
    runtime = tomllib.loads(make_patch(ARM, [delays()[COMMON[0]]], [[DELAY_S]]).runtime)
    written = [(one["place"], one["effect"], one["size"]) for one in runtime["effects"]]
    assert written == [(joint.name, "command delay", {"delay_s": DELAY_S}) for joint in ARM.joints]
    (first, _) = read_effect(runtime["effects"][0], Path("runtime.toml"))
    assert np.isclose(first.sample_delay_s(np.array([[0.0225]])), 0.0025)


@pytest.mark.slow
def test_one_delay_of_all_joints_is_one_finding_and_may_be_either():
    key = COMMON[1]
    (members,) = findings(logs_with(own(key), [DELAY_S] * 3), [*own(key), *(delays()[one] for one in COMMON)])
    assert {*members} == {*COMMON}


@pytest.mark.slow
def test_a_delay_of_one_joint_stays_there():
    (members,) = findings(logs_with([delays()["elbow: command delay"]], [DELAY_S]), [*delays().values()])
    assert members[0] == "elbow: command delay"
    assert not {*COMMON} & {*members}

"""Fits of all joints: coupled ones, common delays, bounds, joints without data, poor nominal models."""

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from helpers.effect_lab import ARM_XML, motion_of, robot_of, simulate
from helpers.pendulum import motion, pendulum, recorded, waves
from helpers.toy import BASE, CATALOGUE, NAMES, Toy, ToyResiduals, draw_toy
from helpers.verdicts import ARMATURE, FRICTION, GAIN
from simgap.assemble import doubt_names, find_interval, list_base
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.effects.actuation import DampingGain
from simgap.effects.effect import Family, Size
from simgap.logs import Logs, Signal
from simgap.patch.patch import make_patch
from simgap.patch.text import read_effect
from simgap.report.details import bound_sentences, finding_sentences
from simgap.residuals.noise import WhitenedResiduals, whiten_noise
from simgap.residuals.residuals import pseudo_huber, refer_to
from simgap.residuals.simulation_residuals import SimulationResiduals, list_kinds
from simgap.selection.acceptance import Candidate, choose_simplest, pays, step_without
from simgap.selection.checkpoint import Meter
from simgap.selection.context import FittedModel, start_context
from simgap.selection.fit import Hypothesis, JointFit, Union
from simgap.selection.fitting import Fitting
from simgap.selection.joint_fits import fit_base, list_starts
from simgap.selection.selection import select_effects
from simgap.selection.sharing import share_nothing
from simgap.selection.verdict import find_confidence_sets, find_pushed, list_members


class Coupled(ToyResiduals):
    """Two joints, the first of which moves the second."""

    def residuals(self, effects, sizes):
        rows = super().residuals(effects, sizes).reshape(-1, *self.commands.shape)
        rows[:, 1] += 0.5 * (rows[:, 0] - self.measured[0])
        return rows.reshape(len(rows), -1)


def test_residuals_of_coupled_joints_are_those_of_their_sizes_together():
    toy = draw_toy(1, {})
    model = Coupled(toy.commands, toy.measured, NAMES)
    context, present = fit_base(start_context(model, BASE, CATALOGUE, 1, Meter()))
    columns = context.union.columns(context.base)
    (rows,) = context.model.residuals(context.base, present.sizes[None, columns])
    for fit in present.fits:
        np.testing.assert_array_equal(fit.residuals, rows[fit.rows])
        np.testing.assert_array_equal(fit.sizes, present.sizes)


def test_joints_without_base_parameters_share_no_simulation_if_they_are_coupled():
    toy = draw_toy(1, {})
    for kind, groups in ((ToyResiduals, ((0, 1),)), (Coupled, ((0,), (1,)))):
        model = kind(toy.commands, toy.measured, NAMES)
        context, _ = fit_base(start_context(model, (), CATALOGUE, 1, Meter()))
        assert context.sharing.groups == groups


def test_a_fit_that_starts_beyond_a_bound_ends_inside():
    model = draw_toy(1, {})
    union = Union(BASE)
    start = Hypothesis(np.arange(1), np.array([9.0, 0.0]), 0)
    fitting = Fitting(model, union, [start], np.full(2, 0.02), sharing=share_nothing(2, np.arange(2)))
    (fit,) = fitting.finish()
    np.testing.assert_allclose(fit.sizes[0], 0.3, atol=0.02)


@pytest.mark.parametrize("seed", range(1, 6))
def test_a_fit_ends_within_a_third_of_a_standard_error_of_its_optimum(seed):
    model = draw_toy(seed, {"near: square": 0.1})
    effects, scale = (BASE[0], CATALOGUE[0]), 0.02
    start = Hypothesis(np.arange(2), np.array([-1.0, 0.0]), 0)
    sharing = share_nothing(2, np.zeros(2, np.int64))
    (fit,) = Fitting(model, Union(effects), [start], np.full(2, scale), sharing=sharing).finish()

    def loss(sizes):
        return float(np.sum(pseudo_huber(model.residuals(effects, sizes[None])[0, fit.rows] / scale)))

    # a standard error adds 1 to a sum of squares over the variance
    assert loss(fit.sizes) < minimize(loss, fit.sizes, method="Nelder-Mead").fun + 1.0 / 9.0


class Folded(ToyResiduals):
    """The gain acts by a curve with a maximum, at which a fit from below it ends."""

    def residuals(self, effects, sizes):
        gain = sizes[:, :1]
        return super().residuals(effects, np.hstack([gain**3 - gain, sizes[:, 1:]]))


@pytest.mark.parametrize("is_known", [True, False])
def test_a_fit_begins_again_where_the_best_of_its_joint_is(is_known):
    toy = draw_toy(1, {"near: square": 0.1})
    model = Folded(toy.commands, toy.measured + 0.7 * toy.commands, NAMES)  # a gain of 1.32 moves as much
    square, cube = CATALOGUE[:2]
    union, sharing = Union((BASE[0], square, cube)), share_nothing(2, np.zeros(3, np.int64))
    poor = Hypothesis(np.array([0, 1]), np.array([-1.0, 0.0, 0.0]), 0)
    good = Hypothesis(np.array([0, 2]), np.array([1.0, 0.0, 0.0]), 0)
    (best,) = Fitting(model, union, [good], np.full(2, 0.02), sharing=sharing).finish()
    own = [poor] if is_known else [poor, good]
    fitting = Fitting(model, union, own, np.full(2, 0.02), sharing=sharing)
    fitting.advance()
    assert fitting.descents[0].sizes[0] < 0.0
    fitting.begin_again(40, [best] if is_known else [])
    fit, *_ = fitting.finish()
    np.testing.assert_allclose(fit.sizes, [1.3247, 0.1, 0.0], atol=0.005)


def test_base_parameters_start_as_in_the_model_and_with_damping_and_armature():
    robot = pendulum(kp=3.0, kd=0.0, damping=0.0)
    logs = [swing(k, (TIME_s < 1.2).astype(float)) for k in range(4)]
    raw = SimulationResiduals(robot, logs, n_threads=1)
    context = start_context(raw, base_effects(robot, Logs(tuple(logs))), (), 1, Meter())
    starts = list_starts(context, 0)
    names = [size.name for size in context.union.sizes]
    damped = np.array([names.index(name) for name in ("damping_Nms_rad", "kd_Nms_rad")])
    armature = starts[:, names.index("armature_kgm2")]
    assert not starts[0].any()
    assert np.all(starts[1:, damped] > 0.0)
    assert 0 < np.count_nonzero(armature[1:]) < len(armature) - 1
    assert np.all(starts <= [size.high for size in context.union.sizes])


def test_a_step_without_a_fold_goes_as_far_as_the_optimum_without_it():
    toy = draw_toy(1, {})
    context, present = fit_base(start_context(toy, BASE, (), 1, Meter()))
    (fold, *_), fit = context.folds, present.fits[0]
    z, slope = fit.residuals / context.scales[0], fit.jacobian[:, 0] / context.scales[0]
    is_other = ~np.isin(context.model.motion_of[fit.rows], sorted(fold))
    sizes = np.linspace(-0.002, 0.002, 4001)  # the model is linear, so that the loss is known without a fit
    losses = np.array([np.sqrt(1.0 + (z + slope * one) ** 2) for one in sizes])
    every, others = (sizes[int(np.argmin(part.sum(axis=1)))] for part in (losses, losses[:, is_other]))
    step = step_without(context, fit, fold)[0] - fit.sizes[0]
    assert step == pytest.approx(others - every, rel=0.05)


@pytest.mark.slow
def test_an_effect_at_a_body_has_an_interval_that_holds_its_size():
    body, held = Toy("base", "square of all", np.square), 0
    for seed in range(10):
        model = draw_toy(seed, {"near: square": 0.1, "far: square": 0.1})
        selection = select_effects(model, BASE, (body,), seed=1)
        (column,) = selection.context.union.columns([body])
        low, high = find_interval(selection.context, selection.chosen, [], int(column))
        held += low < 0.1 < high
        assert high - low < 0.01
    assert held >= 7  # 99 % of a binomial around 9


def test_the_noise_of_all_repeats_counts_in_any_order():
    model = draw_toy(1, {})
    rng = np.random.default_rng(2)
    rows = rng.normal(0.0, 1.0, model.commands.shape)
    rows[:, 0, 1:] += rows[:, 0, :-1]  # one of three repeats remembers
    found = []
    for order in ((0, 1, 2), (2, 1, 0)):
        model.repeat_of = ("a", "a", "a", *("",) * (len(model.motions) - 3))
        moved = rows.copy()
        moved[:, :3] = rows[:, list(order)]
        white = whiten_noise(model, moved.ravel())
        assert isinstance(white, WhitenedResiduals)
        found.append(white.correlation)
    np.testing.assert_allclose(found[0], found[1])


TIME_s = np.arange(0.0, 2.0, 0.01)
TRUE_KD, TRUE_DAMPING = 0.06, 0.005


def swing(seed, on):
    """Record a damped pendulum whose motor has power where `on` is 1."""
    command = waves(TIME_s, seed)
    log = motion(TIME_s, 0.0 * TIME_s + command[0], command, f"m{seed}", enabled=Signal(TIME_s, on))
    return recorded(pendulum(kp=4.0, kd=TRUE_KD, damping=TRUE_DAMPING), log)


@pytest.mark.slow
def test_a_damping_that_acts_under_power_is_told_from_friction_by_a_log_without_power():
    robot = pendulum(kp=3.0, kd=0.0, damping=0.0)
    motions = [swing(k, (TIME_s < 1.2).astype(float)) for k in range(4)]
    base = base_effects(robot, Logs(tuple(motions)))
    assert any(isinstance(one, DampingGain) for one in base)
    always = [swing(k, np.ones(TIME_s.size)) for k in range(4)]
    assert not any(isinstance(one, DampingGain) for one in base_effects(robot, Logs(tuple(always))))
    raw = SimulationResiduals(robot, motions, n_threads=1, fit_starts=True)
    context, present = fit_base(start_context(raw, base, (), 1, Meter()))
    found = {one.name: one.value for one in list_base(robot, context, present, ())}
    assert found["kd_Nms_rad"] == pytest.approx(TRUE_KD, rel=0.05)
    assert found["damping_Nms_rad"] == pytest.approx(TRUE_DAMPING, rel=0.2)
    assert found["gain_ratio"] == pytest.approx(1.0 / 3.0, rel=0.05)


def test_residuals_about_the_nominal_model_are_the_same_bits():
    motions = [swing(1, np.ones(TIME_s.size))]
    robot = pendulum()
    raw = SimulationResiduals(robot, motions, n_threads=1, fit_starts=True)
    base = base_effects(robot, Logs(tuple(motions)))
    nominal = np.zeros(len(base))
    again = refer_to(raw, base, nominal)
    np.testing.assert_array_equal(raw.residuals([], np.zeros((1, 0))), again.residuals([], np.zeros((1, 0))))
    moved = refer_to(raw, base, nominal + 0.01)
    assert not np.array_equal(raw.residuals([], np.zeros((1, 0))), moved.residuals([], np.zeros((1, 0))))


class Bounded(Toy):
    """Toy of which at least 0.3 is there, as in the truth, or more."""

    least = 0.0

    @property
    def sizes(self):
        return (Size(self.label, self.least, 5.0, 1.0),)


@pytest.mark.parametrize(("least", "is_pushed"), [(-5.0, False), (0.3, False), (0.35, True)])
def test_only_a_bound_that_the_motions_contradict_counts(least, is_pushed):
    toy = draw_toy(1, {})
    Bounded.least = least
    base = tuple(Bounded(name, "gain", lambda x: x) for name in NAMES)
    context, present = fit_base(start_context(toy, base, (), 1, Meter()))
    assert [bool(find_pushed(context, fit).size) for fit in present.fits] == [is_pushed] * 2


def test_a_fourth_effect_of_a_joint_has_to_help_from_motion_to_motion():
    toy = draw_toy(1, {})
    near = [one for one in CATALOGUE if one.place == "near"]
    context, present = fit_base(start_context(toy, (), CATALOGUE, 1, Meter()))
    rows = np.flatnonzero(toy.joint_of == 0)
    before = np.ones(toy.joint_of.size)
    fit = JointFit(present.sizes, np.arange(1), 0, before[rows], rows, np.zeros((rows.size, 1)))

    def judge(after, n_taken):
        taken = FittedModel(tuple(near[:n_taken]), present.sizes, present.fits, before)
        return pays(context, taken, Candidate(near[3], (0,), fit, after, False, 0.1, -20.0))

    one_motion = np.where(toy.motion_of[rows] == 0, 0.1, 1.0)
    assert judge(one_motion, 2)
    assert not judge(one_motion, 3)
    assert judge(0.8 * before[rows] * np.linspace(0.9, 1.0, rows.size), 3)


def test_of_effects_that_predict_as_well_the_likeliest_is_chosen():
    toy = draw_toy(1, {})
    context, present = fit_base(start_context(toy, BASE, CATALOGUE, 1, Meter()))
    rows, columns = np.flatnonzero(toy.joint_of == 0), np.arange(1)
    left_out = np.random.default_rng(1).uniform(0.4, 0.6, (2, rows.size))

    def judge(k, residual, gain):
        fit = JointFit(
            present.sizes, columns, 0, np.full(rows.size, residual), rows, np.zeros((rows.size, 1))
        )
        return Candidate(CATALOGUE[k], (0,), fit, left_out[k], False, gain, -20.0)

    for first, second in ((0.010, 0.011), (0.011, 0.010)):
        chosen = choose_simplest(context, [judge(0, first, 0.500), judge(1, second, 0.501)])
        assert chosen.effect is CATALOGUE[0 if first < second else 1]


def test_beside_a_finding_whose_cause_is_not_known_another_has_no_name():
    known, elsewhere = FRICTION, replace(FRICTION, place="elbow")
    unknown = replace(FRICTION, families=(), effects=())
    small = replace(unknown, share=0.4)
    assert doubt_names([known, small]) == [known, small]
    found = doubt_names([known, unknown, elsewhere])
    assert [one.effects for one in found] == [(), (), FRICTION.effects]
    assert [one.families for one in found] == [FRICTION.families, (), FRICTION.families]
    assert "95 % sure of the kind" in finding_sentences(found[:1])[0]


def test_a_base_parameter_at_a_contradicted_bound_is_told():
    (line,) = bound_sentences([GAIN, replace(ARMATURE, value=0.0, is_pushed=True)])
    assert line.startswith("armature of pan (0) ends at its bound, ")


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

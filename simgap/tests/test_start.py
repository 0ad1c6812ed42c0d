"""A diagnosis that starts from an earlier result: what was found acts, and its changes may be found."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.pendulum import at_swing, motion, pendulum, recorded, waves
from helpers.toy import BASE, CATALOGUE, draw_toy
from helpers.verdicts import diagnosis
from simgap import diagnose, verdict_lines
from simgap.arrays import Array
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.common.errors import RobotError
from simgap.effects.actuation import GainError
from simgap.effects.command import CommandDelay, CommonCommandDelay, CommonMeasurementDelay, MeasurementDelay
from simgap.effects.variation import Variation
from simgap.logs import Logs
from simgap.patch.patch import save_patch
from simgap.patch.text import read_found
from simgap.report.traces import trace_motions
from simgap.residuals.conditioned import Change, ConditionedResiduals, KnownResiduals, changes_of
from simgap.residuals.residuals import residuals_by_motion
from simgap.selection.selection import select_effects

TIME_s = np.arange(0.0, 2.0, 0.01)
MODEL = pendulum(kp=3.0)
DELAY_s = 0.03


def swing(seed, delay):
    """Record a pendulum of a third more gain whose commands come late."""
    gain = at_swing(GainError, MODEL)
    command = waves(TIME_s, seed)
    log = motion(TIME_s, 0.0 * TIME_s, command, f"m{seed}")
    return recorded(MODEL, log, (gain, (1 / 3,)), (delay, (DELAY_s,)), noise_rad=1e-4, seed=seed)


@pytest.fixture(scope="module")
def late():
    logs = Logs((motion(TIME_s, 0.0 * TIME_s, waves(TIME_s, 1)),))
    return next(one for one in catalogue(MODEL, logs) if one.key == "swing: command delay")


def test_base_parameters_are_fitted_from_an_earlier_result_and_join_it(tmp_path, late):
    motions = [swing(k, late) for k in range(4)]
    base = base_effects(MODEL, Logs(tuple(motions)))
    sizes: list[tuple[float, ...]] = [(0.3,) if one.name == "gain error" else (0.0,) for one in base]
    earlier = diagnosis(effects=(*base, late), sizes=(*sizes, (DELAY_s,)))
    save_patch(MODEL, earlier, tmp_path)
    start = read_found(MODEL, tmp_path)
    found = diagnose(MODEL, motions[:3], held_out=motions[3:], start=start, base_only=True)
    (error,) = found.errors
    assert error.explained < 2e-4 < error.nominal < 0.05
    (gain,) = (one for one in found.base if one.name == "gain_ratio")
    assert gain.nominal == pytest.approx(0.3)
    assert gain.value == pytest.approx(1 / 3, rel=0.01)
    last = dict(zip((one.key for one in found.effects), found.sizes, strict=True))
    assert last["swing: command delay"] == (DELAY_s,)
    assert last["swing: gain error"] == pytest.approx([1 / 3], rel=0.02)
    assert " with the earlier result; with base parameters " in verdict_lines(found)[2]
    (trace,) = trace_motions(MODEL, motions[3:], found)
    assert np.mean(np.abs(trace.nominal)) == pytest.approx(error.nominal, rel=0.05)
    assert np.mean(np.abs(trace.explained)) < 2e-4


def test_a_change_of_what_was_known_is_found_with_its_sign():
    model, square = draw_toy(3, {"near: square": 0.25}), CATALOGUE[0]
    known = {square: np.array([0.4])}
    changes = changes_of(known)
    found = select_effects(KnownResiduals(model, known), BASE, [*changes, *CATALOGUE[1:]], seed=1)
    (change,) = found.chosen.effects
    assert change.key == "near: change of square"
    size: Array = found.chosen.sizes[found.context.union.columns([change])]
    assert size == pytest.approx([-0.15], abs=0.02)
    assert change.describe(size).endswith(" from 0.4")
    assert Change("near", square, (0.4,)).sizes[0].low == pytest.approx(-5.4)


def test_every_effect_of_the_catalogue_and_a_delay_of_all_joints_can_be_a_start(tmp_path):
    logs = Logs(tuple(motion(TIME_s, 0.1 * waves(TIME_s, k), waves(TIME_s, k), f"m{k}") for k in range(2)))
    effects = list(catalogue(MODEL, logs))
    for kind, own in ((CommonCommandDelay, CommandDelay), (CommonMeasurementDelay, MeasurementDelay)):
        one = at_swing(own, MODEL)
        effects.append(kind((one, replace(one, place="lift")), MODEL.control_period_s))
    sizes = [tuple(0.0 for _ in one.sizes) for one in effects]
    save_patch(MODEL, diagnosis(effects=tuple(effects), sizes=tuple(sizes)), tmp_path)
    again = read_found(MODEL, tmp_path)
    assert [repr(one) for one in again] == [repr(one) for one in effects]


def test_a_result_of_another_robot_is_refused(tmp_path, late):
    save_patch(MODEL, diagnosis(effects=(late,), sizes=((DELAY_s,),)), tmp_path)
    other = replace(MODEL, joints=(replace(MODEL.joints[0], name="lift"),))
    with pytest.raises(RobotError, match=r"are \['swing'\], and the robot has \['lift'\]"):
        read_found(other, tmp_path)


def test_a_start_acts_beside_an_effect_that_follows_a_condition():
    toy = draw_toy(1, {})
    load = np.arange(float(len(toy.motions)))
    square = CATALOGUE[0]
    varied = Variation(square.place, square, "load", load[-1])
    model = KnownResiduals(ConditionedResiduals(toy, {"load": load}), {BASE[0]: np.array([0.1])})
    alike = np.column_stack([np.full(load.size, 0.1), 0.01 * load])[None]
    expected = residuals_by_motion(toy, [BASE[0], square], alike)
    assert model.residuals([varied], np.array([[0.01]])) == pytest.approx(expected)

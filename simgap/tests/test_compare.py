"""Comparison of two sets of logs, and a diagnosis that starts from an earlier result."""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.marks import slow_but
from helpers.pendulum import at_swing, motion, pendulum, recorded, waves, with_signals
from helpers.toy import BASE, CATALOGUE, NAMES, Toy, ToyResiduals, draw_toy
from helpers.verdicts import LIFT, diagnosis, finding
from simgap import diagnose, verdict_lines
from simgap.arrays import Array
from simgap.assemble import select_sure
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.records import Audit
from simgap.common.errors import RobotError
from simgap.compare import compare, list_competing, list_differences, list_limits, tell_apart
from simgap.effects.actuation import GainError
from simgap.effects.command import CommandDelay, CommonCommandDelay, CommonMeasurementDelay, MeasurementDelay
from simgap.effects.effect import Size
from simgap.effects.variation import Difference, Variation
from simgap.logs import Logs
from simgap.patch.patch import save_patch
from simgap.patch.text import read_found
from simgap.report.document import comparison_details, comparison_document, comparison_lines
from simgap.report.traces import trace_motions
from simgap.residuals.conditioned import Change, ConditionedResiduals, KnownResiduals, changes_of
from simgap.residuals.residuals import residuals_by_motion
from simgap.result import Comparison, Limit, Refusal
from simgap.selection.checkpoint import GOES_ON
from simgap.selection.context import Score
from simgap.selection.selection import SHORTLIST, list_best, select_effects

N_MOTIONS = 8


def draw_sets(seed, common, change):
    """Draw two sets of motions; the effects of the second differ by a change."""
    after = {key: common.get(key, 0.0) + change.get(key, 0.0) for key in {*common, *change}}
    sets = [draw_toy(seed, common, N_MOTIONS), draw_toy(seed + 100, after, N_MOTIONS)]
    arrays = ([getattr(one, of) for one in sets] for of in ("commands", "measured"))
    commands, measured = (np.concatenate(one, axis=1) for one in arrays)
    model = ToyResiduals(commands, measured, NAMES)
    repeats = (*("",) * (N_MOTIONS - 2), "r", "r")
    model.motions = tuple(f"{part}:{k}" for part in ("before", "after") for k in range(N_MOTIONS))
    model.repeat_of = tuple(one and f"{part}:{one}" for part in ("before", "after") for one in repeats)
    return model


def compare_toys(model):
    shown = (*CATALOGUE, *BASE)  # a catalogue may have what is in the base too
    found = select_effects(tell_apart(model), BASE, list_competing(BASE, shown), seed=1)
    return select_sure(found, None)[0]


CHANGES = {"none": {}, "new": {"far: sine": 0.05}, "gone": {"near: square": -0.1}}


@pytest.mark.parametrize(("name", "seed"), slow_but(product(CHANGES, range(1, 6)), ("none", 1), ("new", 1)))
def test_a_change_is_named_with_its_size_and_what_is_common_is_not(name, seed):
    change = CHANGES[name]
    found = compare_toys(draw_sets(seed, {"near: square": 0.1}, change))
    columns = found.context.union.columns
    sizes = {one.key: float(found.chosen.sizes[columns([one])][0]) for one in list_differences(found)}
    assert sizes.keys() == {key.replace(": ", ": change of ") for key in change}
    assert [*sizes.values()] == pytest.approx([*change.values()], rel=0.1)


def test_a_change_that_was_not_seen_has_a_limit():
    limits = list_limits(compare_toys(draw_sets(1, {}, {})))
    assert [(one.place, one.name) for one in limits] == [("near", "gain"), ("far", "gain")]
    assert all(one.low <= 0.0 <= one.high and one.high - one.low < 0.01 for one in limits)


@dataclass(frozen=True)
class Amount(Toy):
    """Toy whose size is not negative."""

    @property
    def sizes(self):
        return (Size(self.label, 0.0, 5.0, 1.0),)


def test_an_amount_that_grows_acts_after_and_one_that_falls_before():
    raw = draw_sets(1, {}, {})
    amount, is_after = Amount("near", "square", np.square), raw.motion_of >= N_MOTIONS
    change = Difference("near", amount)
    (none,), (all_of_it,) = (raw.residuals([amount], np.array([[size]])) for size in (0.0, 2.0))
    for size, acts in ((2.0, is_after), (-2.0, ~is_after)):
        model = tell_apart(raw)
        order = np.lexsort((raw.time_s, raw.joint_of, raw.motion_of))
        (moved,) = model.residuals([change], np.array([[size]]))
        expected = np.where(acts, all_of_it, none)[order]
        place = np.lexsort((model.time_s, model.joint_of, model.motion_of))
        assert np.array_equal(moved[place], expected)
    assert (change.name, change.describe(np.array([-2.0]))) == ("change of square", "square -2")


def test_an_effect_and_its_change_count_once_in_the_shortlist_and_are_both_refitted():
    effects = [*CATALOGUE[: SHORTLIST + 1], Difference("near", CATALOGUE[0])]
    ranked = [Score(one, np.zeros(0), 0.1) for one in effects]
    assert [one.effect for one in list_best(ranked)] == [*effects[:SHORTLIST], effects[-1]]


def test_four_lines_tell_a_change_or_what_could_not_be_seen():
    limit = Limit("lift", "gain_ratio", -0.02, 0.03)
    found = diagnosis(findings=(finding(effect="change of gain", text="gain_ratio -0.1"),))
    where, what, far, following = comparison_lines(Comparison(found, (limit,)))
    assert where == "Where: lift."
    assert what.startswith("What: change of gain at lift (gain_ratio -0.1), 95 % sure")
    assert far == (
        "How far: with one model for both, the error of lift is 12 mrad; with the changes 2.4 mrad "
        "(noise: 2 mrad)."
    )
    nothing = Comparison(replace(found, findings=(), errors=(LIFT,)), (limit,))
    where, what, _, following = comparison_lines(nothing)
    assert where == "Where: nowhere; one model fits both sets of logs."
    assert what == "What: nothing changed that these logs show."
    found_so = replace(found, findings=(), errors=(replace(LIFT, noise_floor=0.0),))
    assert "the error left is not judged" in comparison_lines(Comparison(found_so, (limit,)))[0]
    assert following == "Not seen: smaller changes; the limits of each joint follow."
    limits = "Changes may lie within gain_ratio of lift from -0.02 to +0.03 (90 %)."
    assert comparison_details(nothing)[-1] == limits
    sure = replace(limit, low=0.01)
    one_side = (
        "Changes may lie within gain_ratio of lift from +0.01 to +0.03, not sure enough to be named (90 %)."
    )
    assert comparison_details(replace(nothing, limits=(sure,)))[-1] == one_side
    assert comparison_document(nothing)["verdict"] == "none"
    beside = f"Beside what was found, c{limits[1:]}"
    assert comparison_details(Comparison(found, (limit,)))[-1] == beside
    assert comparison_lines(replace(nothing, limits=()))[3] == "No base parameter can be told."


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


@pytest.mark.parametrize("armature_kgm2", [0.0, 0.01])
def test_base_parameters_are_fitted_from_an_earlier_result_and_join_it(tmp_path, late, armature_kgm2):
    """An armature of an earlier result may fall below that of the model, down to 0."""
    motions = [swing(k, late) for k in range(4)]
    base = base_effects(MODEL, Logs(tuple(motions)))
    known = {"gain error": 0.3, "armature": armature_kgm2}
    sizes = [(known.get(one.name, 0.0),) for one in base]
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
    assert last["swing: armature"] == pytest.approx([0.0], abs=2e-4)
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


def test_a_known_effect_that_is_gone_is_named_as_its_change():
    model, gone = draw_toy(3, {}), replace(CATALOGUE[0], low=0.0)
    known = {gone: np.array([0.2])}
    found = select_effects(KnownResiduals(model, known), BASE, changes_of(known), seed=1)
    (change,) = found.chosen.effects
    size = found.chosen.sizes[found.context.union.columns([change])]
    assert size == pytest.approx([-0.2], abs=0.002)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("\ndelay_s = 0.03", "\ndelay_s = nan", "delay_s is nan; write 0 to 0.2"),
        ("\ndelay_s = 0.03", "\ndelay_s = 7.0", "delay_s is 7; write 0 to 0.2"),
        ("joints = ", "joint = ", "joint: is not known; did you mean joints?"),
        ('\nname = "swing"', '\nname = "lift"', "mode, gains, limit or gear are not those of the robot file"),
        ("\nindex = 0", "\nindex = 7", "mode, gains, limit or gear are not those of the robot file"),
        ('place = "swing"\nindex', 'place = "lift"\nindex', "mode, gains, limit or gear are not those"),
        ("[effects.fields.joint]", "[effects.fields.nothing]", "cannot be made"),
        ("kp_Nm_rad = ", "kp_Nm_rad = 1", "mode, gains, limit or gear are not those of the robot file"),
    ],
)
def test_a_result_that_is_damaged_or_of_another_joint_is_refused(tmp_path, late, old, new, said):
    save_patch(MODEL, diagnosis(effects=(late,), sizes=((0.03,),)), tmp_path)
    path = tmp_path / "effects.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(RobotError) as error:
        read_found(MODEL, tmp_path)
    assert said in str(error.value)


def test_a_result_with_an_effect_that_stands_there_twice_is_refused(tmp_path, late):
    save_patch(MODEL, diagnosis(effects=(late,), sizes=((0.03,),)), tmp_path)
    path = tmp_path / "effects.toml"
    head, table = path.read_text().split("[[effects]]")
    path.write_text("[[effects]]".join([head, table, table]))
    with pytest.raises(RobotError, match=r"effects.toml: two effects have the same name and place; keep one"):
        read_found(MODEL, tmp_path)


def test_a_result_does_not_start_from_the_model_that_it_patched(tmp_path, late):
    save_patch(MODEL, diagnosis(effects=(late,), sizes=((DELAY_s,),)), tmp_path)
    for model, said in (("patched.xml", "in which the effects of .* act already"), ("model.xml", "")):
        (tmp_path / "model.xml").write_text("<mujoco/>")
        robot = replace(MODEL, path=tmp_path / "robot.toml", file=SimpleNamespace(model=model))
        with pytest.raises(RobotError, match=said) if said else nullcontext():
            read_found(robot, tmp_path)


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


def test_what_the_check_refuses_is_told_of_each_set_before_a_comparison(late):
    before, after = swing(0, late), swing(1, late)
    audits = [
        Audit((), (), refused, {(one.name, "swing"): np.ones(TIME_s.size, dtype=bool)})
        for one, refused in ((before, ()), (after, (Refusal("m1", "spike", 3),)))
    ]
    found = compare(MODEL, [before], [after], audits=audits)
    assert found.found.refused == (Refusal("after:m1", "spike", 3),)
    assert "after:m1: 3 samples took no part: spike." in comparison_details(found)


@pytest.mark.slow
def test_a_comparison_that_was_interrupted_goes_on_and_ends_with_the_same_bits(late, tmp_path):
    sets = [[swing(k, late)] for k in range(2)]

    def stop(share, text):
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stopped:
        compare(MODEL, *sets, progress=stop, cache=tmp_path)
    assert stopped.value.__notes__ == [GOES_ON]
    assert [*tmp_path.rglob("*.npz")]
    told: list[str] = []
    again = compare(MODEL, *sets, progress=lambda share, text: told.append(text), cache=tmp_path)
    assert told[0] == "going on"
    assert comparison_document(again) == comparison_document(compare(MODEL, *sets))
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("case", ["copy", "no command", "torque in one"])
def test_sets_that_cannot_be_compared_are_refused(late, case):
    before, after = swing(0, late), swing(1, late)
    if case == "copy":
        after, said = replace(before, name="m1"), "motion m1 after is a copy of m0 before"
    elif case == "no command":
        logs = [
            replace(one.joints["swing"], command=None, secondary=one.joints["swing"].position)
            for one in (before, after)
        ]
        before, after = (
            replace(one, joints={"swing": log}) for one, log in zip((before, after), logs, strict=True)
        )
        said = "no command and no torque"
    else:
        after, said = with_signals(after, torque=0.0 * TIME_s), "joint swing: no torque is logged before"
    with pytest.raises(RobotError, match=said):
        compare(MODEL, [before], [after])

"""Verdicts in words, and their JSON document: what is said, and what is not said where it is not known."""

import json
from dataclasses import replace
from math import inf

import pytest

from helpers.arm_folder import write_arm
from helpers.verdicts import (
    ARMATURE,
    FRICTION,
    GAIN,
    LIFT,
    PAN,
    REFUSED,
    REST,
    diagnosis,
    finding,
    without_floor,
)
from simgap.effects.effect import Family
from simgap.report.details import detail_lines
from simgap.report.document import to_document
from simgap.report.sentences import level, verdict_lines, verdict_word
from simgap.report.traces import convert_errors, find_user_unit
from simgap.result import Rejected
from simgap.robot import Robot
from simgap.units import quantity

TWO = finding(effects=("lift: Coulomb friction", "lift: gain error"), next_motion="slow sweeps of lift")
FOUR_EFFECTS = finding(effects=tuple("abcd"))
FOUR_FAMILIES = finding(effects=tuple("abcd"), families=tuple(Family)[:4])
FOUR_PLACES = finding(effects=tuple("abcd"), families=tuple(Family)[:4], places=tuple("pqrs"))
LARGE = replace(REST, mean_abs=2.5 * PAN.noise_floor)
NO_EFFECT = finding(effects=(), families=(), places=("lift",))


def lines(**changes):
    return verdict_lines(diagnosis(**changes))


def test_four_lines_say_where_what_how_far_and_next():
    assert lines() == (
        "Where: lift.",
        "What: Coulomb friction at lift (0.44 N m), 95 % sure: no other effect explains it.",
        "How far: on 2 motions that took no part, the error of lift is 25.5 mrad; with base parameters "
        "12 mrad; with the findings 2.4 mrad (noise: 2 mrad). The findings take 80 % of what base "
        "parameters left.",
        "Next: nothing; these motions leave no question open.",
    )


def test_the_joint_with_the_largest_error_is_told_not_that_with_the_best_share_and_an_error_that_grows():
    small = replace(PAN, nominal=0.003, base=0.003, explained=0.0001)
    assert "the error of lift is 25.5 mrad" in lines(errors=(small, LIFT))[2]
    worse = replace(LIFT, explained=1.5 * LIFT.base)
    assert "The findings add 50 % of what base parameters left" in lines(errors=(worse,))[2]


def test_what_is_left_beyond_twice_the_noise_stands_in_the_first_line():
    much = replace(LIFT, explained=0.0124)
    (where, *_) = lines(errors=(much,), remaining=(replace(REST, joint="lift", mean_abs=0.0124),))
    assert where.endswith("Something more remains at lift, 12.4 mrad at lift, which is 6.2 times the noise.")


def test_the_finding_that_explains_most_comes_first_and_a_sentence_is_said_once():
    small, large = (finding(effect=name, share=share) for name, share in (("creep", 0.1), ("hum", 0.7)))
    what = lines(findings=(small, large))[1]
    assert what.index("hum") < what.index("creep")
    assert what.count("95 % sure: no other effect explains it") == 1
    many = lines(findings=(small, small, small, large))[1]
    assert many.startswith("What: mainly hum at lift")
    assert many.endswith("; and 1 more finding.")


def test_nine_findings_begin_with_the_main_one_and_no_sentence_is_said_twice():
    nine = [finding(effect=f"hum {k}", place=f"j{k}", places=(f"j{k}",), share=0.1) for k in range(8)]
    pushed = [replace(ARMATURE, place=f"j{k}", is_pushed=True) for k in range(3)]
    rests = tuple(replace(REST, joint=f"j{k}", depends_on="") for k in range(6))
    said = detail_lines(diagnosis(findings=(*nine, FRICTION), base=tuple(pushed), remaining=rests))
    assert said[0] == "For each of the next 9 findings: 95 % sure; no other effect explains it."
    assert said[1].startswith("Coulomb friction at lift (0.44 N m). With 90 % probability")
    text = " ".join(said)
    for words in ("no other effect explains it", "No effect explains what remains", "ask for more"):
        assert text.count(words) == 1
    assert "At j0, j1 and j2, the logs do not determine: armature." in said


def test_a_set_that_no_recorded_motion_separates_asks_for_another_kind():
    following = lines(findings=(replace(TWO, next_motion=""),))[3]
    assert following.startswith("Next: no recorded motion tells Coulomb friction or gain error at lift apart")


def test_effects_that_are_not_named_for_one_reason_share_a_sentence():
    reason = "a1: gravity does not load it"
    alike = tuple(Rejected("a1", name, reason) for name in ("joint compliance", "backlash"))
    said = detail_lines(diagnosis(rejected=alike))
    assert "Joint compliance and backlash at a1 are not named: gravity does not load it." in said


def test_the_main_finding_is_that_of_the_largest_error_of_its_own_kind():
    torque = replace(LIFT, unit="N m", base=2000.0, kind="inverse dynamics")
    small = replace(torque, joint="pan", base=40.0)
    skew = replace(LIFT, kind="second encoder", base=0.0005)
    two = (finding(place="pan", effect="creep", share=0.9), finding(effect="hum", share=0.6))
    kind = "inverse dynamics and second encoder"
    what = lines(findings=two, errors=(torque, small, skew), kind=kind)[1]
    assert what.index("hum") < what.index("creep")


def test_errors_are_told_in_the_unit_of_the_user_and_without_an_exponent(tmp_path):
    write_arm(tmp_path)
    text = (tmp_path / "robot.toml").read_text()
    (tmp_path / "robot.toml").write_text(text.replace('unit = "rad" }', 'unit = "deg" }'))
    robot = Robot.from_toml(tmp_path / "robot.toml")
    name = robot.joints[0].name
    errors = (replace(LIFT, joint=name, nominal=0.1), replace(LIFT, joint=name, unit="N m", nominal=2043.6))
    first, second = convert_errors(robot, diagnosis(errors=errors)).errors
    assert (first.unit, first.nominal) == ("deg", pytest.approx(5.73, abs=0.01))
    assert quantity(second.nominal, second.unit) == "2040 N m"
    motor = 'torque = { column = "x", unit = "N m", side = "motor" }\ngear_ratio = 100\nposition ='
    (tmp_path / "robot.toml").write_text(text.replace("position =", motor, 1))
    geared = Robot.from_toml(tmp_path / "robot.toml")
    assert find_user_unit(geared, name, "N m") == ("N m of the motor", 0.01)


def test_two_effects_that_these_motions_cannot_tell_apart_are_both_named_with_the_next_motion():
    where, what, _, following = lines(findings=(TWO,))
    assert where == "Where: lift."
    assert "Coulomb friction or gain error at lift, 95 % sure" in what
    assert "cannot be told apart" in what
    assert following == "Next: record slow sweeps of lift."
    assert verdict_word(diagnosis(findings=(TWO,))) == "set"


@pytest.mark.parametrize(
    ("found", "known", "words"),
    [
        (FRICTION, "effect", "Coulomb friction at lift"),
        (FOUR_EFFECTS, "family", "friction at lift, 95 % sure of the kind"),
        (FOUR_FAMILIES, "place", "something at lift, 95 % sure of the place"),
        (FOUR_PLACES, "none", "something that is not located"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_more_than_three_members_are_told_one_level_above(found, known, words):
    assert level(found) == known
    assert words in lines(findings=(found,))[1]


def test_a_set_of_more_than_three_effects_lists_none_of_them():
    many = finding(effects=("lift: creep", "lift: hum", "lift: wobble", "lift: sag"))
    text = " ".join([*lines(findings=(many,)), *detail_lines(diagnosis(findings=(many,)))])
    assert not any(word in text for word in ("creep", "hum", "wobble", "sag", "0.44"))


def test_an_empty_set_says_none_of_these_and_keeps_the_place():
    where, what, *_ = lines(findings=(NO_EFFECT,))
    assert where == "Where: lift."
    assert "no effect in the catalogue is known to cause it" in what
    assert verdict_word(diagnosis(findings=(NO_EFFECT,))) == "unknown"


def test_no_finding_and_no_remainder_is_none():
    nothing = diagnosis(findings=(), base=(), effects=(), sizes=())
    where, what, *_ = verdict_lines(nothing)
    assert verdict_word(nothing) == "none"
    assert where.startswith("Where: nowhere")
    assert what == "What: none of the effects in the catalogue."


def test_a_base_parameter_that_accounts_for_most_of_an_error_says_where_and_what():
    rest = replace(REST, mean_abs=1.5 * PAN.noise_floor)
    small = replace(GAIN, name="armature", nominal=0.1, value=0.101, interval=(0.1005, 0.1015), share=0.02)
    only = diagnosis(findings=(), base=(small, GAIN), remaining=(rest,), effects=(), sizes=())
    where, what, _, following = verdict_lines(only)
    assert where == "Where: lift."
    assert what == (
        "What: gain of lift is 12.2, in the model 17.8; none of the effects in the catalogue explains what "
        "remains."
    )
    assert following == "Next: nothing; what remains is less than twice the noise."
    said = detail_lines(only)
    assert said[1] == (
        "gain of lift is 12.2, in the model 17.8; with 90 % probability from 11.9 to 12.5. "
        "With that of the model, 90 % of the error of its joint comes back."
    )
    assert not any("armature" in one for one in said)
    gain = replace(GAIN, name="gain_ratio", nominal=0.0, value=0.991, interval=(0.98, 1.0))
    said = "gain_ratio of lift differs from the model by +99.1 %; with 90 % probability from +98 % to +100 %."
    assert detail_lines(replace(only, base=(gain,)))[1].startswith(said)


def test_base_parameters_alone_tell_the_error_of_each_joint_and_no_verdict():
    base = diagnosis(findings=(), remaining=(REST,), effects=(), sizes=(), is_base_only=True)
    where, what, _, following = verdict_lines(base)
    assert where == "Where: no effect was looked for."
    (much, *_) = verdict_lines(replace(base, errors=(replace(LIFT, explained=0.0124),)))
    assert much.startswith(
        "Where: no effect was looked for; base parameters leave 12.4 mrad at lift, which is "
    )
    assert what == "What: gain of lift is 12.2, in the model 17.8."
    assert following == "Next: look for effects: diagnose with the whole catalogue."
    assert verdict_word(base) == "unknown"
    said = detail_lines(base)
    assert "Mean error of lift: 25.5 mrad as it is, 12 mrad with base parameters." in said
    assert any(one.startswith("Base parameters do not explain what remains: 1.1 mrad") for one in said)


def test_a_remainder_without_a_finding_is_unknown_at_its_joint():
    only = diagnosis(findings=(), base=(), remaining=(LARGE,), effects=(), sizes=())
    where, what, _, following = verdict_lines(only)
    assert verdict_word(only) == "unknown"
    assert where == "Where: pan."
    assert "none of the effects in the catalogue explains what remains" in what
    assert following == "Next: write an effect of your own at pan that depends on position."


def test_a_named_effect_is_not_withdrawn_because_something_else_remains():
    assert lines(remaining=(REST,))[0] == "Where: lift."
    where, what, *_ = lines(remaining=(LARGE,))
    assert where == "Where: lift. Something more remains at pan."
    assert "Coulomb friction at lift" in what
    assert verdict_word(diagnosis(remaining=(REST,))) == "named"


def test_without_repeats_the_noise_is_not_known():
    errors = (PAN, without_floor(LIFT))
    _, _, far, following = lines(errors=errors)
    assert "noise: not known without repeats" in far
    assert following.startswith("Next: repeat some motions")
    assert diagnosis(errors=errors).closure is None


def test_without_held_out_motions_the_fall_is_not_known():
    _, _, far, following = lines(judged_motions=())
    assert far == "How far: not known, because no motion was held out."
    assert following.startswith("Next: hold out some motions")
    assert diagnosis(judged_motions=()).closure is None


def test_the_closure_is_one_at_the_floor_zero_at_the_nominal_model_and_none_between_equal_ones():
    assert diagnosis(errors=(replace(LIFT, explained=LIFT.noise_floor),)).closure == pytest.approx(1.0)
    assert diagnosis(errors=(replace(LIFT, explained=LIFT.nominal),)).closure == pytest.approx(0.0)
    assert diagnosis(errors=(replace(LIFT, nominal=LIFT.noise_floor),)).closure is None


def test_a_joint_without_gravity_load_shows_only_ratios_to_the_gain():
    gain = replace(ARMATURE, name="gain_ratio")
    said = detail_lines(diagnosis(base=(GAIN, ARMATURE, gain)))
    assert "At pan, only ratios to the gain can be known of: armature." in said
    assert not any("At lift" in line for line in said)


def test_details_give_interval_share_and_what_the_remainder_depends_on():
    said = detail_lines(diagnosis(remaining=(REST,)))
    assert said[0].endswith(
        "With 90 % probability coulomb_Nm from 0.41 to 0.47. "
        "Without it, 80 % of the explainable error of its joint comes back."
    )
    assert said[1] == (
        "No effect explains what remains: 1.1 mrad at pan in slow motion, 40 % of which position explains."
    )


def test_three_refusals_are_listed_and_the_others_counted():
    said = detail_lines(diagnosis(base=(), refused=REFUSED))
    assert said[1] == "p: 40 samples took no part: the command is cut off at -1.034 rad."
    assert said[-1] == "2 more refusals are in the JSON document."


def test_remarks_on_the_logs_stand_beside_the_findings():
    remarks = ("lift: many turns: it turns 9 times.",) * 5
    lines = detail_lines(diagnosis(remarks=remarks))
    assert lines[-4:-1] == list(remarks[:3])
    assert lines[-1] == "2 more remarks on the logs are in the JSON document."


FULL = diagnosis(
    findings=(finding(next_motion="slow sweeps"), finding(place="pan", interval=((0.0, inf),))),
    base=(GAIN, ARMATURE),
    remaining=(REST,),
    refused=REFUSED,
)


def written(one):
    """Return the document as a program reads it from a file."""
    return json.loads(json.dumps(to_document(one), allow_nan=False))


def test_a_document_has_the_verdict_in_a_word_and_in_lines_and_every_number_of_a_finding():
    document = written(FULL)
    assert document["verdict"] == "named"
    assert [line.partition(":")[0] for line in document["lines"]] == ["Where", "What", "How far", "Next"]
    (first, second) = document["findings"]
    assert first["sizes"] == [{"name": "coulomb_Nm", "value": 0.44, "low_90": 0.41, "high_90": 0.47}]
    assert (first["place"], first["family"], first["effect"]) == ("lift", "friction", "Coulomb friction")
    assert second["sizes"][0]["high_90"] == "inf"


def test_an_unknown_floor_is_null_and_stays_unknown():
    document = written(diagnosis(errors=(without_floor(LIFT),)))
    assert document["errors"][0]["noise_floor"] is None
    assert document["closure_share"] is None

"""Truth, files and score of the cases of servos with poor models."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from simgap.loading import load
from simgap.robot import Robot
from validation.cases.robot import plan_robot_cases, write_logs
from validation.cases.robot_draw import DrawnEffect, Truth, record_logs
from validation.cases.robot_score import SealedCase
from validation.cases.robot_setup import ADDED, PERIOD_S, SERVOS, load_robot, sample_times, write_robot
from validation.cases.robot_truth import Nuisances
from validation.cases.servo import KIND_SHARES, is_settled, say_what_is_open, score_cases
from validation.cases.servo_truth import ServoPlant

MODEL = "servo_200g_100mm"
FRICTION = DrawnEffect("Stribeck friction", "servo", "friction", 0.02, 0.5, 4.0, ("friction",))


def simulate(motor, start_rad, added_kg=0.0, **factors):
    """Return a servo, all factors 0 but those given, and its motion with one command and one gain."""
    names = ("damping", "friction", "armature", "gain")
    ones = Nuisances(**{name: np.array([factors.get(name, 0.0)]) for name in names})
    plant = ServoPlant(load_robot(MODEL), ones, (), 0.00025, added_kg)
    command = np.full((1, 301), start_rad)
    gains = np.where(np.arange(301) < 1, 400.0, motor)
    return plant, plant.simulate(command, PERIOD_S, 1, (25.0, 25.0), gains)[0]


@pytest.mark.parametrize("added_kg", [0.0, 0.1])
def test_a_servo_without_power_and_losses_swings_with_the_period_of_its_weights(added_kg, tmp_path):
    plant, q = simulate(0.0, 0.02, added_kg, gain=100.0)
    model = Robot.from_toml(write_robot(tmp_path, MODEL)).under({ADDED: added_kg}).model
    assert plant.link_kgm2 == pytest.approx(model.dof_M0[0])
    assert plant.weight_Nm == pytest.approx(model.body_subtreemass[0] * 9.81 * 0.1)
    half_s = math.pi * math.sqrt(plant.link_kgm2 / plant.weight_Nm)
    lowest = np.argmin(q[: round(1.5 * half_s / PERIOD_S)])
    assert PERIOD_S * lowest == pytest.approx(half_s, abs=2.0 * PERIOD_S)
    assert -q[lowest] == pytest.approx(q[0], rel=0.01)


def test_dry_friction_holds_the_weight_up_to_its_size():
    for share, holds in ((1.05, True), (0.95, False)):
        weight_Nm = 0.2 * 9.81 * 0.1 * math.sin(0.3)
        _, q = simulate(0.0, 0.3, gain=100.0, friction=share * weight_Nm / 0.021)
        assert (np.ptp(q) < 1e-6) == holds


def test_a_logged_servo_comes_back_with_its_gains_power_and_poor_model(tmp_path):
    logs = record_logs(Truth(MODEL, "none", 1000, (), {}))
    robot = Robot.from_toml(write_robot(tmp_path, MODEL))
    write_logs(tmp_path / "log.parquet", logs)
    read = load(robot, tmp_path / "log.parquet")
    assert len({one.gain["servo"] for one in read.fit}) == 6
    (off,) = [one for one in read.fit if not one.joints["servo"].enabled.value.all()]
    np.testing.assert_array_equal(off.joints["servo"].enabled.value > 0.5, sample_times() < 3.0)
    assert robot.model.dof_damping[0] == robot.model.dof_armature[0] == 0.0


def test_sixty_cases_have_their_kinds():
    plans = plan_robot_cases(60, 7, tuple(SERVOS), KIND_SHARES)
    assert Counter(one.kind for one in plans) == {"none": 20, "single": 14, "pair": 13, "triple": 13}


TRUTH = Truth(MODEL, "single", 1000, (FRICTION,), {})
SEALED = SealedCase("case-000", TRUTH, ((("Stribeck friction", "servo"),),))


def found(*effects, first=""):
    return {
        "place": "servo", "family": "friction", "effect": first or effects[0], "places": ["servo"],
        "families": ["friction"], "effects": [f"servo: {one}" for one in effects],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("effects", "known", "open_as", "settling"),
    [
        (["Stribeck friction"], True, "", []),
        (["spring", "Stribeck friction"], True, "set", [["Stribeck friction"]]),
        (
            ["spring", "dead zone"],
            True,
            "wrong name",
            [["Stribeck friction"], ["spring", "Stribeck friction"], []],
        ),
        ([], True, "place", [["Stribeck friction"]]),
        ([], False, "", []),
    ],
)
def test_a_motion_settles_what_was_open_by_the_right_name_or_without_a_wrong_one(
    effects, known, open_as, settling
):
    before = {"findings": [found(*effects, first="spring")]}
    told = {"finding": "servo: spring", "open": open_as}
    assert (
        say_what_is_open(SEALED, before, "servo: spring", {"Stribeck friction"} if known else set())
        == open_as
    )
    for after in (["Stribeck friction"], ["spring", "Stribeck friction"], ["spring", "dead zone"], []):
        result = {**before, "next": told, "after": {"findings": [found(*after, first="spring")]}}
        assert not open_as or is_settled(SEALED, result) == (after in settling)


def test_only_a_single_wrong_effect_is_sure_and_wrong():
    def bars(*effects):
        solved = [(SEALED, {"findings": [found(*effects)], "seconds": 1.0})]
        return {name: one["hits"] for name, one in score_cases(solved).document["bars"].items()}

    assert bars("Stribeck friction") == {
        "sure and wrong": 0, "reported": 1, "named": 1, "right effect of those named": 1, "false alarms": 0
    }  # fmt: skip
    assert bars("integral leak")["sure and wrong"] == 1
    assert bars("integral leak", "Stribeck friction")["sure and wrong"] == 0
    below = replace(SEALED, truth=replace(TRUTH, effects=(replace(FRICTION, times_limit=1.9),)))
    assert score_cases([(below, {"findings": [], "seconds": 1.0})]).document["bars"]["reported"]["of"] == 0

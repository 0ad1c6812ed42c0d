"""Diagnoses of a real KR300 and a real XL330: named effects hold for motions that took no part."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.real_robots import exchange_commands, load_real, robot_path
from simgap.catalogue.catalogue import catalogue
from simgap.common.errors import RobotError
from simgap.compare import compare
from simgap.diagnosis import diagnose
from simgap.effects.effect import Family
from simgap.loading import load
from simgap.logs import Signal
from simgap.residuals.inverse_residuals import InverseResiduals, shows
from simgap.robot import Robot

pytestmark = [pytest.mark.real_data, pytest.mark.slow]
GEAR = 267.43


def find(folder, split):
    """Return robot, diagnosis, and the torque error of axis 2 on the other batch [motor N m, RMS]."""
    robot = Robot.from_toml(robot_path("kr300"))
    logs = load(robot, [folder / "kr300_A.parquet", folder / "kr300_B.parquet"], split=split)
    result = diagnose(robot, logs.fit, held_out=logs.judged, seed=1)
    other = InverseResiduals(robot, logs.judged)
    pairs = [pair for pair in zip(result.effects, result.sizes, strict=True) if shows(pair[0])]
    sizes = np.array([[size for _, one in pairs for size in one]])
    (residuals,) = other.residuals([effect for effect, _ in pairs], sizes)
    error = float(np.sqrt(np.mean(residuals[other.joint_of == 1] ** 2))) / GEAR
    return robot, result, error


def list_names(result):
    return {(one.place, one.effect) for one in result.findings}


@pytest.fixture(scope="module")
def fitted_a(real_data):
    return find(real_data / "kr300", "fit_a")


@pytest.fixture(scope="module")
def fitted_b(real_data):
    return find(real_data / "kr300", "fit_b")


def torque_at_axis_2(result):
    return next(one for one in result.findings if (one.place, one.family) == ("a2", Family.EXTERNAL))


def test_batch_a_names_an_external_torque_at_axis_2_that_holds_for_batch_b(fitted_a):
    _, result, error = fitted_a
    assert {*torque_at_axis_2(result).effects} & {"a2: position-dependent torque", "a2: spring"}
    assert error < 1.5


def test_batch_b_names_an_external_torque_at_axis_2(fitted_b):
    assert torque_at_axis_2(fitted_b[1]).effects


def test_batch_b_names_a_torque_at_axis_2_that_holds_for_batch_a(fitted_b):
    assert fitted_b[2] < 1.5


@pytest.mark.parametrize(("batch", "split"), [("fitted_a", "fit_a"), ("fitted_b", "fit_b")])
def test_without_external_torques_axis_2_remains_and_no_other_name_comes(
    batch, split, real_data, request, monkeypatch
):
    _, whole, _ = request.getfixturevalue(batch)
    monkeypatch.setattr(
        "simgap.diagnosis.catalogue",
        lambda robot, logs: [e for e in catalogue(robot, logs) if e.family is not Family.EXTERNAL],
    )
    _, result, _ = find(real_data / "kr300", split)
    remains = {(one.joint, one.unit): one.depends_on for one in result.remaining}
    assert remains["a2", "N m of the motor"] in ("position", "load")  # gravity makes a load of each position
    members = {key for one in whole.findings for key in one.effects}
    named = {(place, name) for place, name in list_names(result) if f"{place}: {name}" not in members}
    assert named < list_names(whole)


@pytest.mark.parametrize("batch", ["fitted_a", "fitted_b"])
@pytest.mark.parametrize("axis", ["a2", "a3"])
def test_each_batch_names_the_compliance_of_axes_2_and_3(batch, axis, request):
    _, result, _ = request.getfixturevalue(batch)
    assert (axis, "joint compliance") in list_names(result)


AXIS_3 = pytest.mark.xfail(
    reason="A: 12.5 to 16.5, beside a scale of the encoder; B: 18.3 to 21.0 1e-8 rad/(N m), without one",
    strict=True,
)


@pytest.mark.parametrize("axis", ["a2", pytest.param("a3", marks=AXIS_3)])
def test_the_batches_agree_on_the_compliance_of_axes_2_and_3(axis, fitted_a, fitted_b):
    found = [one for _, result, _ in (fitted_a, fitted_b) for one in result.findings]
    pair = [one.interval[0] for one in found if (one.place, one.effect) == (axis, "joint compliance")]
    assert max(low for low, _ in pair) < min(high for _, high in pair)


@pytest.mark.parametrize("batch", ["fitted_a", "fitted_b"])
def test_backlash_is_named_nowhere(batch, request):
    _, result, _ = request.getfixturevalue(batch)
    assert "backlash" not in {one.effect for one in result.findings}


@pytest.mark.parametrize("batch", ["fitted_a", "fitted_b"])
def test_each_pair_of_encoders_has_a_time_skew_of_3_ms(batch, request):
    _, result, _ = request.getfixturevalue(batch)
    skews = {one.place: one.size[0] for one in result.findings if one.effect == "measurement delay"}
    assert skews == {axis: pytest.approx(3.0e-3, abs=0.2e-3) for axis in ("a1", "a2", "a3")}


@pytest.mark.parametrize("batch", ["fitted_a", "fitted_b"])
def test_no_compliance_is_named_at_axis_1_which_gravity_does_not_load(batch, request):
    _, result, _ = request.getfixturevalue(batch)
    assert not [one for one in result.findings if (one.place, one.effect) == ("a1", "joint compliance")]
    assert [one for one in result.rejected if (one.place, one.effect) == ("a1", "joint compliance")]


@pytest.fixture(scope="module")
def swung(real_data):
    """The servo with a pendulum, judged on a gain that was held out."""
    robot, logs = load_real(real_data, "pendulum")
    assert {motion.conditions["gain_kp"] for motion in logs.judged} == {400.0}
    return diagnose(robot, logs.fit, held_out=logs.judged, seed=1)


def test_few_effects_are_found_beside_load_dependent_friction(swung):
    (error,) = swung.errors
    assert error.base > 0.055
    assert len(swung.findings) <= 4
    assert "load-dependent friction" in {one.effect for one in swung.findings}


def test_the_gain_that_was_held_out_is_predicted_within_32_mrad(swung):
    assert swung.errors[0].explained < 0.032


def is_refused(robot, motions):
    """Return whether a diagnosis ends in an error, or without a fitted motion."""
    try:
        result = diagnose(robot, motions, seed=1)
    except RobotError:
        return True
    return not result.findings and not result.fitted_motions


def test_a_servo_with_the_commands_of_other_motions_is_refused(real_data):
    robot, logs = load_real(real_data, "pendulum")
    assert is_refused(robot, exchange_commands(logs.motions, 1))


def delayed(log):
    return replace(log, position=Signal(log.position.time_s + 0.02, log.position.value))


@pytest.fixture(scope="module")
def found_later(real_data):
    """What is found where positions are stamped 20 ms later."""
    robot, logs = load_real(real_data, "pendulum")
    later = [
        replace(motion, joints={name: delayed(log) for name, log in motion.joints.items()})
        for motion in logs.motions
    ]
    return diagnose(robot, later, seed=1).findings


def test_positions_that_are_stamped_20_ms_later_may_be_a_delay(found_later):
    assert any("servo: measurement delay" in one.effects for one in found_later)


def test_beside_the_delay_no_more_is_found_than_without_it(real_data, found_later):
    robot, logs = load_real(real_data, "pendulum")
    others = [one for one in found_later if "servo: measurement delay" not in one.effects]
    assert len(others) <= len(diagnose(robot, logs.motions, seed=1).findings)


@pytest.fixture(scope="module")
def change(real_data):
    """The one change where positions of half of the logs are stamped 20 ms later."""
    robot, logs = load_real(real_data, "pendulum")
    # four motions for each of four gains: either half has two of each gain and of each motion
    halves = [[one for k, one in enumerate(logs.motions) if (k // 4 + k) % 2 == half] for half in (0, 1)]
    late = [replace(one, joints={key: delayed(log) for key, log in one.joints.items()}) for one in halves[1]]
    (found,) = compare(robot, halves[0], late, seed=1).found.findings
    return found


def test_a_delay_of_half_of_the_logs_is_what_changed(change):
    assert change.effect == "change of command delay"


def test_the_interval_of_the_delay_holds_20_ms(change):
    low, high = change.interval[0]
    assert low < 0.02 < high

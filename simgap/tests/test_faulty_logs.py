"""The audit names faults that people's logs have, and is silent about motions that only look like them."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.marks import slow_but
from helpers.planar_arm import COUNT_RAD, RATE_HZ, commands, planar_arm, record, slow_logs, with_joint
from helpers.robot_folder import COLUMNS, write_parquet, write_robot
from simgap.checks.audit import audit
from simgap.checks.records import REFUSED, RemarkKind, Samples
from simgap.checks.signals import spike_flags
from simgap.files.motion_rows import unwrap_counters
from simgap.files.robot_file import JointTable
from simgap.loading import load
from simgap.logs import Logs, Signal
from simgap.robot import Robot


@pytest.fixture(scope="module")
def clean():
    return slow_logs(planar_arm())


def remarks(logs, kind):
    return [one for one in audit(planar_arm(), logs).remarks if one.kind is kind]


def change_position(change):
    """Return a change of the log of a joint that puts other values in the place of its positions."""
    return lambda log: replace(log, position=replace(log.position, value=change(log.position.value.copy())))


def take_rows(log, rows):
    """Return the log of a joint with these rows, of its position and its command."""
    signals = {name: getattr(log, name) for name in ("position", "command")}
    return replace(log, **{name: Signal(one.time_s[rows], one.value[rows]) for name, one in signals.items()})


def with_joints(logs, change):
    """Return logs whose joints both have a change."""
    return with_joint(with_joint(logs, "shoulder", change), "elbow", change)


def samples(position, command=None):
    time_s = np.arange(position.size) / RATE_HZ
    sent = np.full(position.size, np.nan) if command is None else command
    return Samples(np.arange(position.size), time_s, position, sent)


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("size_rad", slow_but([-3.14, 0.1], 0.1))
def test_samples_that_jump_away_are_named_and_left_out(clean, width, size_rad):
    def jump(value):
        for first in (50, 61, 300):
            value[first : first + width] += size_rad
        return value

    logs = with_joint(clean, "elbow", change_position(jump))
    (found,) = remarks(logs, RemarkKind.SPIKE)
    assert (found.joint, len(found.motions)) == ("elbow", 4)
    usable = audit(planar_arm(), logs).is_usable("motion 2", "elbow")
    assert set(np.flatnonzero(~usable)) == {first + k for first in (50, 61, 300) for k in range(width)}


@pytest.mark.parametrize("frequency_Hz", [0.5, 4.0, 8.0, 12.5, 16.0, 25.0])
@pytest.mark.parametrize("noise_rad", [0.0, 1e-4, 1e-2])
def test_oscillation_and_noise_are_no_spikes(frequency_Hz, noise_rad):
    random = np.random.default_rng(int(frequency_Hz))
    time_s = np.arange(5000) / RATE_HZ
    wave = np.sin(2 * np.pi * frequency_Hz * time_s + 0.3) * np.minimum(time_s, 1.0)
    position = wave + noise_rad * random.standard_normal(time_s.size)
    position = np.round(position / COUNT_RAD) * COUNT_RAD
    assert not spike_flags(samples(position), COUNT_RAD).any()


def test_the_answer_to_a_pulse_is_no_spike():
    command, position = np.zeros(200), np.zeros(200)
    command[100], position[101] = 1.0, 0.4
    assert not spike_flags(samples(position, command), COUNT_RAD).any()


@pytest.mark.parametrize("zero_rad", [0.0, 3.0, -3.0])
def test_angles_that_wrap_are_refused(clean, zero_rad):
    logs = with_joint(clean, "shoulder", change_position(lambda value: value + zero_rad))
    wrapped = with_joint(logs, "shoulder", change_position(lambda value: np.angle(np.exp(1j * value))))
    jumps = any(np.ptp(np.diff(one.joints["shoulder"].position.value)) > 6.0 for one in wrapped.motions)
    assert bool(remarks(wrapped, RemarkKind.WRAP)) is jumps is (zero_rad != 0.0)


TURN_RAD = 2 * np.pi
TURNS = 0.4 * np.sin(np.linspace(0.0, 9.0, 100)) + 0.1
"""Turns of a joint that crosses the zero of its counter."""
HALF = (-TURN_RAD / 2, TURN_RAD / 2)
NO_LIMITS = (-np.inf, np.inf)


def unwrap(signals, range_rad=NO_LIMITS, gear=1.0, side="joint", **command):
    """Unwrap the signals of a joint, each a list of turns by motion; return turns, and the counts."""
    counter = {"column": "q", "unit": "count", "counts_per_turn": 4096, "side": side}
    columns = {"position": counter, "command": counter | {"column": "c"} | command}
    if command:
        columns["command"].pop("counts_per_turn")
    table = JointTable.model_validate({"mode": "position", "gear_ratio": gear, **columns})
    rad = {key: [TURN_RAD / gear * one for one in motions] for key, motions in signals.items()}
    given = {key: [Signal(np.arange(one.size), one) for one in motions] for key, motions in rad.items()}
    found, count = unwrap_counters(table, given, range_rad)
    return {key: [one.value * gear / TURN_RAD for one in motions] for key, motions in found.items()}, count


@pytest.mark.parametrize(("side", "gear"), [("joint", 1.0), ("motor", 10.0)])
def test_a_counter_of_one_turn_is_unwrapped_and_one_of_many_is_as_it_was(side, gear):
    for shown, expected, count in ((TURNS % 1.0, TURNS, [2]), (np.arange(100.0), np.arange(100.0), [None])):
        found, wraps = unwrap({"position": [shown]}, gear=gear, side=side)
        assert wraps == count
        np.testing.assert_allclose(found["position"][0], expected, atol=1e-12)


def test_each_motion_of_a_counter_lies_in_the_range_of_the_model():
    shown = [TURNS % 1.0, 0.9 + 0.05 * TURNS, 0.2 + 0.05 * TURNS]
    found, wraps = unwrap({"position": shown}, HALF)
    for one, expected in zip(found["position"], (TURNS, shown[1] - 1.0, shown[2]), strict=True):
        np.testing.assert_allclose(one, expected, atol=1e-12)
    assert wraps == [2, 0, None]


@pytest.mark.parametrize("range_rad", [HALF, NO_LIMITS])
def test_a_command_that_does_not_cross_zero_gets_the_turn_of_its_position(range_rad):
    sent = 1.0 + 0.2 * TURNS - 0.1
    found, _ = unwrap({"position": [TURNS % 1.0], "command": [sent]}, range_rad)
    np.testing.assert_allclose(found["command"][0], sent - 1.0, atol=1e-12)
    np.testing.assert_allclose(found["position"][0], TURNS, atol=1e-12)


def test_a_counter_without_limits_has_the_turn_of_a_command_that_knows_it():
    found, _ = unwrap({"position": [TURNS % 1.0], "command": [TURNS + 2.0]}, unit="rad")
    np.testing.assert_allclose(found["position"][0], TURNS + 2.0, atol=1e-12)
    np.testing.assert_allclose(found["command"][0], TURNS + 2.0, atol=1e-12)


def test_motions_of_a_counter_without_limits_agree():
    found, _ = unwrap({"position": [(0.05 + TURNS) % 1.0, (TURNS - 0.02) % 1.0]})
    assert np.abs(found["position"][0] - found["position"][1]).max() < 0.1


@pytest.mark.parametrize(
    ("zero_rad", "value", "said"),
    [
        (2 * np.pi, 1.0, "a turn above the range of the model: add zero_rad = -6.28319"),
        (3.1, 3.1, "beside its command"),
    ],
)
def test_positions_from_another_zero_are_refused(clean, zero_rad, value, said):
    logs = with_joint(clean, "elbow", change_position(lambda value: value + zero_rad))
    (found,) = remarks(logs, RemarkKind.UNIT)
    assert found.joint == "elbow"
    assert found.value == pytest.approx(value, abs=0.05)
    assert said in found.text


def test_exchanged_joints_are_named_each_with_the_other(clean):
    def exchange(motion):
        shoulder, elbow = (motion.joints[name] for name in ("shoulder", "elbow"))
        one, other = replace(shoulder, position=elbow.position), replace(elbow, position=shoulder.position)
        return replace(motion, joints={"shoulder": one, "elbow": other})

    logs = replace(clean, motions=tuple(map(exchange, clean.motions)))
    found = [(one.joint, one.text.split()[6]) for one in remarks(logs, RemarkKind.ORDER)]
    assert found == [("shoulder", "elbow"), ("elbow", "shoulder")]


def test_joints_with_like_commands_are_not_exchanged():
    sent = [commands(k, -0.6, 0.4) for k in range(3)]
    same = [one | {"elbow": one["shoulder"]} for one in sent]
    logs = Logs(tuple(record(planar_arm(), k, one) for k, one in enumerate(same)))
    assert not remarks(logs, RemarkKind.ORDER)


def test_a_position_that_never_changes_while_its_command_rests_cannot_be_identified(clean):
    def rest(log):
        still = Signal(log.position.time_s, np.full(log.position.time_s.size, 0.3))
        return replace(log, position=still, command=still)

    logs = with_joint(clean, "elbow", rest)
    (found,) = remarks(logs, RemarkKind.STILL)
    assert "never moves: its position stays at 0.3 rad. Nothing about" in found.text
    assert not remarks(logs, RemarkKind.CONSTANT)


def test_a_position_that_never_changes_while_its_command_moves_is_refused(clean):
    logs = with_joint(clean, "elbow", change_position(lambda value: 0.0 * value))
    (found,) = remarks(logs, RemarkKind.CONSTANT)
    assert "the position stays at 0 rad, while the command spans" in found.text
    assert not remarks(logs, RemarkKind.STILL)


def test_a_command_that_never_changes_while_the_joint_moves_on_is_refused_unless_the_power_was_off(clean):
    def hold(log):
        return replace(log, command=replace(log.command, value=0.0 * log.command.value))

    held = with_joint(clean, "elbow", hold)
    (found,) = remarks(held, RemarkKind.CONSTANT)
    assert "the command never changes, while the position spans" in found.text

    def switch_off(log):
        return replace(log, enabled=replace(log.command, value=0.0 * log.command.value))

    assert not remarks(with_joint(held, "elbow", switch_off), RemarkKind.CONSTANT)


def test_a_position_that_is_ahead_of_its_command_is_told(clean):
    def exchange(log):
        return replace(log, position=log.command, command=log.position)

    (found,) = remarks(with_joint(clean, "shoulder", exchange), RemarkKind.AHEAD)
    assert found.joint == "shoulder"
    assert 0.02 <= found.value <= 0.2
    assert not remarks(clean, RemarkKind.AHEAD)


@pytest.mark.parametrize("frequency_Hz", [1.0, 3.5, 5.0])
def test_a_fast_wave_that_lags_is_not_ahead(clean, frequency_Hz):
    def swing(log):
        wave = 0.3 * np.sin(2 * np.pi * frequency_Hz * (log.position.time_s - 0.15))
        sent = 0.3 * np.sin(2 * np.pi * frequency_Hz * log.command.time_s)
        shown = replace(log, position=Signal(log.position.time_s, wave))
        return replace(shown, command=Signal(log.command.time_s, sent))

    assert not remarks(with_joint(clean, "shoulder", swing), RemarkKind.AHEAD)


@pytest.mark.parametrize("step_rad", [0.0, COUNT_RAD])
def test_a_joint_that_only_shows_noise_cannot_be_identified(clean, step_rad):
    random = np.random.default_rng(3)

    def hold(value):
        value = 0.3 + 0.001 * random.standard_normal(value.size)
        return np.round(value / step_rad) * step_rad if step_rad else value

    def keep(log):
        held = change_position(hold)(log)
        return replace(held, command=Signal(log.command.time_s, np.full(log.command.time_s.size, 0.3)))

    (found,) = remarks(with_joint(clean, "elbow", keep), RemarkKind.STILL)
    assert found.joint == "elbow"


def test_a_motor_that_is_switched_on_late_is_named(clean):
    def wait(value):
        value[:100] = value[0]
        return value

    (found,) = remarks(with_joint(clean, "shoulder", change_position(wait)), RemarkKind.START)
    assert found.joint == "shoulder"
    assert found.value == pytest.approx(100 / RATE_HZ)


@pytest.mark.parametrize("factor", slow_but([0.1, 3.0, 10.0, 25.0], 0.1, 3.0))
def test_times_in_another_unit_are_told_with_their_factor_by_the_velocities(clean, factor):
    def slow(log):
        speed = np.gradient(log.position.value, log.position.time_s)
        time_s = factor * log.position.time_s
        signals = {name: Signal(time_s, getattr(log, name).value) for name in ("position", "command")}
        return replace(log, velocity=Signal(time_s, speed), **signals)

    (found,) = remarks(with_joints(clean, slow), RemarkKind.UNIT)
    assert found.joint == ""
    assert found.value == pytest.approx(factor, rel=0.1)
    assert ("too long" if factor > 1.0 else "too short") in found.text


def test_a_clock_that_steps_forward_is_told_with_the_step(clean):
    def step(log):
        time_s = log.position.time_s + np.where(np.arange(log.position.time_s.size) > 300, 0.5, 0.0)
        return replace(log, position=replace(log.position, time_s=time_s))

    told = remarks(with_joint(clean, "elbow", step), RemarkKind.MISSING)
    (found,) = (one for one in told if one.joint == "elbow")
    assert "0.52 s at once" in found.text


def test_a_pause_of_all_signals_is_told_with_windows_and_has_no_missing_rows(clean):
    def pause(log):
        return take_rows(log, (log.position.time_s < 3.0) | (log.position.time_s > 4.0))

    one = replace(clean, motions=clean.motions[:1])
    found = audit(planar_arm(), with_joints(one, pause))
    (remark,) = found.remarks
    assert (remark.kind, remark.joint) == (RemarkKind.PAUSE, "")
    assert "no signal is logged for 1.04 s, once: end the motion there" in remark.text
    assert {rate.n_missing for rate in found.rates} == {0}


def test_what_the_logs_cannot_show_is_told(clean):
    assert audit(planar_arm(), clean).untested == (
        "times that are wrong by less than a factor of 100, as no velocity that changes is logged",
    )
    blind = with_joints(clean, lambda log: replace(log, command=None))
    assert "exchanged and reversed joints" in audit(planar_arm(), blind).untested[0]


@pytest.mark.parametrize(("every", "is_slow"), [(1, False), (20, False), (60, True)])
def test_a_command_of_few_rows_a_wave_is_too_fast_for_the_rate(clean, every, is_slow):
    thin = with_joint(clean, "shoulder", lambda log: take_rows(log, slice(None, None, every)))
    found = [one.joint for one in remarks(thin, RemarkKind.SLOW)]
    assert found == ["shoulder"] * is_slow  # whose wave is 6 s long, at 50 Hz
    assert not remarks(thin, RemarkKind.STILL)


@pytest.mark.parametrize(("rows", "is_short"), [(4, True), (15, True), (20, False)])
def test_a_motion_that_ends_before_a_joint_settles_is_refused_for_that_alone(clean, rows, is_short):
    logs = with_joints(clean, lambda log: take_rows(log, slice(rows)))
    found = [one.kind for one in audit(planar_arm(), logs).remarks if one.kind in REFUSED]
    assert found == [RemarkKind.SHORT] * is_short


@pytest.mark.parametrize(("key", "kind"), [("velocity", RemarkKind.MISSING), ("torque", RemarkKind.CONSTANT)])
def test_a_signal_that_never_changes_while_the_joint_moves_was_not_measured(clean, key, kind):
    def add(value):
        return lambda log: replace(log, **{key: Signal(log.position.time_s, value(log.position.time_s))})

    (found,) = remarks(with_joint(clean, "elbow", add(np.zeros_like)), kind)
    assert f"the {key}" in found.text
    assert "stays at 0 while the joint moves" in found.text
    assert not remarks(with_joint(clean, "elbow", add(np.cos)), kind)


def test_counts_that_are_too_many_for_the_model_are_asked_for_those_of_a_turn(tmp_path):
    time_s = np.arange(100) / 100
    turns = np.sin(6.0 * time_s)  # of the joint: 6.28 rad, and the model ends at 2
    columns = {name: [0.0] * 100 for name in COLUMNS} | {"t": 1e3 * time_s, "motion": ["m"] * 100}
    columns |= {"gain": [1.0] * 100, "q2": 50 * 4096 * turns}
    robot = Robot.from_toml(write_robot(tmp_path))
    logs = load(robot, write_parquet(tmp_path, **columns))
    (found,) = [one for one in audit(robot, logs).remarks if one.kind is RemarkKind.UNIT]
    assert "is counts_per_turn = 4096 right? With 16384 or more it would fit" in found.text


@pytest.mark.parametrize(("says", "is_asked"), [("", True), ('angle="radian"', False)])
def test_a_model_that_has_lost_its_unit_is_asked_for(clean, says, is_asked):
    robot = planar_arm()
    robot.model.jnt_range[:] = np.radians(robot.model.jnt_range)
    robot = replace(robot, model_xml=robot.model_xml.replace('angle="radian"', says))
    found = [one for one in audit(robot, clean).remarks if one.kind is RemarkKind.UNIT]
    assert [one.joint for one in found] == ["shoulder", "elbow"]
    assert all('or has the model lost angle="radian"?' in one.text for one in found) is is_asked

"""The audit and the nominal model name what is wrong with logs, and are silent where nothing is."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.marks import slow_but
from helpers.pendulum import motion, pendulum
from helpers.planar_arm import RATE_HZ, TABLE_M, commands, planar_arm, record, slow_logs, with_joint
from helpers.real_robots import load_real
from simgap.checks.audit import audit
from simgap.checks.commands import count_foreign_commands, find_unlike_repeats
from simgap.checks.records import RemarkKind
from simgap.command.check import simulate_nominal
from simgap.common.errors import RobotError
from simgap.diagnosis import check_audit, check_motions, diagnose
from simgap.logs import JointLog, Logs, Signal
from simgap.result import Refusal
from simgap.simulation.compiled import Models

TABLE_MOTIONS = {
    *("boundary_exploration", "diagonal_sweep", "dual_joint_elbow_wrist", "figure_eight"),
    *("hold_under_gravity", "hover_positions", "large_amplitude", "oscillation_low_freq"),
    *("oscillation_med_freq", "single_joint_elbow", "workspace_sweep"),
}
"""Motions of the SO-101 whose commands go below the table, as the data's description lists them."""


@pytest.fixture(scope="module")
def clean():
    return slow_logs(planar_arm())


def kinds(found):
    return [(one.kind, one.joint) for one in found.remarks]


def cut_off(joint, cut):
    """Record four motions of an arm that takes other commands of one joint than those that are logged."""
    sent = [commands(k, -0.6, 0.4) for k in range(4)]
    return Logs(tuple(record(planar_arm(), k, s, s | {joint: cut(s[joint])}) for k, s in enumerate(sent)))


def reasons(found):
    return {one.reason for one in found.refused}


def test_clean_logs_get_no_remark_and_keep_every_sample(clean):
    found = audit(planar_arm(), clean)
    assert found.remarks == ()
    assert found.refused == ()
    assert found.is_usable("motion 0", "elbow").all()
    assert {round(one.rate_Hz, 6) for one in found.rates} == {RATE_HZ}


def test_a_table_is_named_with_its_height_and_its_samples_are_refused():
    logs = slow_logs(planar_arm(table=True), low=-0.5, high=1.0)
    found = audit(planar_arm(), logs)
    assert kinds(found) == [(RemarkKind.CONTACT, "")]
    (remark,) = found.remarks
    assert remark.value == pytest.approx(TABLE_M, abs=0.005)
    assert remark.interval[0] <= remark.value <= remark.interval[1]
    assert reasons(found) == {"contact with a plane"}
    assert 0.05 < np.mean(~found.is_usable("motion 3", "shoulder")) < 0.6


@pytest.mark.parametrize(("joint", "clamp"), slow_but([("elbow", 0.38), ("shoulder", 0.2)], ("elbow", 0.38)))
def test_a_command_that_is_cut_off_is_named_with_its_value(joint, clamp):
    found = audit(planar_arm(), cut_off(joint, lambda sent: np.minimum(sent, clamp)))
    assert kinds(found) == [(RemarkKind.CUT_OFF, joint)]
    (remark,) = found.remarks
    assert remark.interval[0] <= clamp <= remark.interval[1]
    assert remark.value == pytest.approx(clamp, abs=0.01)
    other = "elbow" if joint == "shoulder" else "shoulder"
    assert not found.is_usable("motion 3", joint).all()
    assert found.is_usable("motion 3", other).all()


@pytest.mark.parametrize("limit_Nm", slow_but([1.3, 1.4, 1.5], 1.4))
def test_a_motor_that_is_too_weak_is_no_command_that_is_cut_off(limit_Nm):
    weak = planar_arm(torque_limit_Nm=limit_Nm)
    found = audit(planar_arm(), slow_logs(weak, low=-1.2, high=0.4))
    assert RemarkKind.CUT_OFF not in {one.kind for one in found.remarks}


def test_a_stop_against_the_largest_load_may_be_a_torque_limit():
    logs = cut_off("shoulder", lambda sent: np.maximum(sent, -0.3))
    found = audit(planar_arm(), logs)
    (remark,) = found.remarks
    assert (remark.kind, remark.joint) == (RemarkKind.SATURATION, "shoulder")
    assert "look alike" in remark.text
    assert found.refused == ()  # effects of the catalogue tell them apart


@pytest.mark.parametrize("limit_Nm", [2.0, np.inf])
@pytest.mark.parametrize(("highest_Nm", "expected"), [(2.0, [(RemarkKind.SATURATION, "elbow")]), (9.0, [])])
def test_a_torque_at_its_limit_is_saturation_and_a_smooth_peak_is_none(clean, limit_Nm, highest_Nm, expected):
    def add_torque(log):
        wave = np.round(4.0 * np.sin(2 * np.pi * log.position.time_s / 3.0), 1)
        return replace(log, torque=Signal(log.position.time_s, np.clip(wave, -highest_Nm, highest_Nm)))

    robot = planar_arm(torque_limit_Nm=max(limit_Nm, highest_Nm))
    assert kinds(audit(robot, with_joint(clean, "elbow", add_torque))) == expected


def test_positions_that_repeat_while_the_joint_moves_are_stale_and_refused(clean):
    def freeze(log):
        value = log.position.value.copy()
        for begin in range(80, value.size, 60):
            value[begin : begin + 8] = value[begin]
        return replace(log, position=replace(log.position, value=value))

    found = audit(planar_arm(), with_joint(clean, "shoulder", freeze))
    assert kinds(found) == [(RemarkKind.STALE, "shoulder")]
    assert "stale" in reasons(found)


def test_positions_that_friction_holds_are_not_stale():
    sent = commands(0, -0.6, 0.4)
    sent["elbow"] = np.where(np.arange(sent["elbow"].size) % 200 < 100, 0.2, 0.21)
    assert audit(planar_arm(), Logs((record(planar_arm(), 0, sent),))).remarks == ()


def test_missing_rows_and_an_uneven_rate_are_named(clean):
    def lose(log):
        keep = np.ones(log.position.value.size, bool)
        keep[100:120] = False
        return replace(log, position=Signal(log.position.time_s[keep], log.position.value[keep]))

    def shake(log):
        late_s = np.where(np.arange(log.position.time_s.size) % 2, 0.008, 0.0)
        return replace(log, position=replace(log.position, time_s=log.position.time_s + late_s))

    def end_early(log):
        return replace(log, position=Signal(log.position.time_s[:-300], log.position.value[:-300]))

    def lose_commands(log):
        kept = np.r_[0:200, 300 : log.command.value.size]
        return replace(log, command=Signal(log.command.time_s[kept], log.command.value[kept]))

    def warm_up(log):
        time_s = np.arange(log.position.time_s[0] - 0.5, log.position.time_s[-1] + 0.5, 0.2)
        return replace(log, temperature=Signal(time_s, 20.0 + time_s))

    n = len(clean.motions)
    for change, said in ((lose, "20 rows"), (end_early, "300 rows"), (lose_commands, "100 rows")):
        found = audit(planar_arm(), with_joint(clean, "elbow", change))
        (remark,) = (one for one in found.remarks if one.kind is RemarkKind.MISSING)
        assert remark.joint == "elbow"
        count, rest = said.split()
        assert remark.text.startswith(f"{n * int(count)} {rest}")
    assert kinds(audit(planar_arm(), with_joint(clean, "elbow", warm_up))) == []
    assert kinds(audit(planar_arm(), with_joint(clean, "elbow", shake))) == [(RemarkKind.JITTER, "elbow")]


def test_positions_that_are_no_numbers_are_refused(clean):
    def spoil(log):
        value = log.position.value.copy()
        value[10:20] = np.nan
        return replace(log, position=replace(log.position, value=value))

    found = audit(planar_arm(), with_joint(clean, "elbow", spoil))
    assert (RemarkKind.MISSING, "elbow") in kinds(found)
    assert not found.is_usable("motion 0", "elbow")[10:20].any()


def test_poses_in_which_the_model_goes_into_its_table_are_named():
    logs = slow_logs(planar_arm(), low=-0.5, high=1.0, count=2)
    found = audit(planar_arm(table=True), logs)
    assert [one.kind for one in found.remarks] == [RemarkKind.COLLISION]
    assert "world" in found.remarks[0].text


@pytest.mark.real_data
def test_table_and_clamp_of_the_measured_so101_are_named(real_data):
    found = audit(*load_real(real_data, "so101"))
    contact, cut_off = found.remarks
    assert contact.kind is RemarkKind.CONTACT
    assert contact.text.startswith("gripperframe")
    assert contact.value == pytest.approx(-0.045, abs=0.005)
    assert (cut_off.kind, cut_off.joint) == (RemarkKind.CUT_OFF, "wrist_roll")
    assert cut_off.value == pytest.approx(-1.034, abs=0.005)
    assert len(TABLE_MOTIONS - set(contact.motions)) <= 1  # hover_positions only just touches
    assert {one.motion for one in found.refused if one.reason == "contact with a plane"} >= TABLE_MOTIONS
    left_out = {one.motion: one.n_samples for one in found.refused if one.motion == "single_joint_wrist_roll"}
    assert left_out["single_joint_wrist_roll"] > 300


@pytest.mark.real_data
@pytest.mark.parametrize("robot", ["pendulum", "kr300"])
def test_logs_of_other_robots_lose_no_sample_and_have_the_units_of_their_files(real_data, robot):
    found = audit(*load_real(real_data, robot))
    assert found.refused == ()
    assert RemarkKind.UNIT not in {one.kind for one in found.remarks}


def test_a_joint_without_limits_that_turns_often_may_be_in_degrees(clean):
    def scale(log):
        degrees = {name: getattr(log, name) for name in ("position", "command")}
        return replace(log, **{name: replace(s, value=np.degrees(s.value)) for name, s in degrees.items()})

    robot = planar_arm()
    robot.model.jnt_limited[1] = False
    assert (RemarkKind.TURNS, "elbow") in kinds(audit(robot, with_joint(clean, "elbow", scale)))
    assert audit(robot, clean).remarks == ()


@pytest.mark.parametrize(
    ("elsewhere_A", "said"),
    [(0.0, "its current is 0 elsewhere, as against a hard stop"), (0.1, "is 10 times the usual there")],
)
def test_the_current_at_a_stop_is_compared_with_that_elsewhere(elsewhere_A, said):
    def measure(log):
        current_A = np.where(log.command.value > 0.38, 1.0, elsewhere_A)
        return replace(log, current=Signal(log.command.time_s, current_A))

    logs = cut_off("elbow", lambda sent: np.minimum(sent, 0.38))
    found = audit(planar_arm(), with_joint(logs, "elbow", measure))
    texts = [one.text for one in found.remarks]
    assert any(said in text for text in texts), texts


def test_logs_of_which_nothing_is_usable_are_not_diagnosed(clean):
    found = audit(planar_arm(), clean)
    nothing = {place: np.zeros_like(flags) for place, flags in found.usable.items()}
    refused = (Refusal("motion 0", "contact with a plane", 9),)
    with pytest.raises(RobotError, match=r"no sample .* can be used \(contact with a plane\)"):
        diagnose(planar_arm(), clean.motions, audit=replace(found, usable=nothing, refused=refused))


@pytest.mark.parametrize("begin_s", [0.0, 0.3, 1.7e9])
def test_the_error_of_the_model_does_not_depend_on_where_the_clock_starts(begin_s):
    motion = record(planar_arm(), 1, commands(1, -0.6, 0.4))
    time_s = motion.joints["elbow"].position.time_s + begin_s
    time_s = time_s - time_s[0]  # rounded as the times of a log are
    logs = motion.joints.items()
    signals = {name: [replace(s, time_s=time_s) for s in (one.position, one.command)] for name, one in logs}
    moved = replace(motion, joints={name: JointLog(*one) for name, one in signals.items()})
    found = simulate_nominal(Models(planar_arm()), moved).mean_abs_rad
    expected = simulate_nominal(Models(planar_arm()), motion).mean_abs_rad
    assert found == pytest.approx(expected, abs=1e-6)


def test_a_simulation_that_blows_up_has_no_error():
    robot = planar_arm()
    stiff = replace(robot, joints=tuple(replace(one, kp_Nm_rad=1e12) for one in robot.joints))
    motion = record(robot, 1, commands(1, -0.6, 0.4))
    free = replace(stiff, joints=tuple(replace(o, torque_limit_Nm=np.inf) for o in stiff.joints))
    assert np.isnan(simulate_nominal(Models(free), motion).mean_abs_rad["shoulder"])


TIME_s = np.arange(0.0, 8.0, 0.02)
COMMANDS = [0.5 * np.sin((1.0 + 0.4 * k) * TIME_s) for k in range(6)]


@pytest.mark.parametrize(("gain", "offset_rad"), [(1.0, 0.0), (0.3, -0.8), (1.2, 0.4)])
def test_a_shift_of_all_commands_is_counted_and_their_own_are_not(gain, offset_rad):
    random = np.random.default_rng(1)
    noisy = [offset_rad + gain * one + random.normal(0.0, 0.01, one.size) for one in COMMANDS]
    positions = [Signal(TIME_s, one) for one in noisy]
    own = [Signal(TIME_s, one) for one in COMMANDS]
    assert count_foreign_commands([*zip(positions, own, strict=True)]) == 0
    assert count_foreign_commands([*zip(positions, own[1:] + own[:1], strict=True)]) == 6


def test_a_command_that_is_too_short_is_no_rival():
    positions = [Signal(TIME_s, one) for one in COMMANDS[:2]]
    short = [Signal(TIME_s[:100], COMMANDS[1][:100]), Signal(TIME_s[:100], COMMANDS[0][:100])]
    assert count_foreign_commands([*zip(positions, short, strict=True)]) == 0


def test_repeats_with_other_commands_are_refused_and_late_ones_are_not(clean):
    labelled = [replace(one, repeat_of="a") for one in clean.motions[:2]]
    (remark, *_) = find_unlike_repeats(planar_arm(), [*labelled, *clean.motions[2:]])
    assert remark.motions == ("motion 1",)
    with pytest.raises(RobotError, match="repeats have other commands"):
        check_audit(audit(planar_arm(), Logs(tuple(labelled))), labelled)
    sent = labelled[0].joints
    late = {name: replace(one, command=shifted(one.command, 0.05)) for name, one in sent.items()}
    again = replace(labelled[0], name="again", joints=late)
    assert not [*find_unlike_repeats(planar_arm(), [labelled[0], again])]
    shown = [with_holes(one) for one in labelled]
    assert [one.motions for one in find_unlike_repeats(planar_arm(), shown)] == [("motion 1",)]


def with_holes(motion):
    """Return a motion without commands, in which every seventh position is missing."""
    joints = {}
    for name, log in motion.joints.items():
        value = np.where(np.arange(log.position.value.size) % 7, log.position.value, np.nan)
        joints[name] = replace(log, command=None, position=Signal(log.position.time_s, value))
    return replace(motion, joints=joints)


def shifted(signal, late_s):
    """Return a signal that is late."""
    return Signal(signal.time_s + late_s, signal.value)


def test_a_motion_that_is_fitted_twice_is_refused():
    robot = pendulum()
    one = motion(np.arange(0.0, 1.0, 0.01), np.zeros(100), np.zeros(100))
    with pytest.raises(RobotError, match="motion m: is fitted twice"):
        check_motions(robot, [one, one], [])

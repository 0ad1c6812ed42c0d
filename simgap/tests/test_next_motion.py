"""The next motion: which of some motions tells rivals apart best, and what base parameters absorb of that."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from helpers import two_joint_arm
from helpers.command import run_simgap, snapshot
from helpers.pendulum import motion, pendulum, recorded, waves, with_signals
from helpers.robot_folder import ROBOT as ROBOT_FILE
from helpers.robot_folder import write_csv, write_robot
from helpers.verdicts import diagnosis
from simgap.arrays import Array
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.command.next_motion import command_table
from simgap.common.errors import RobotError
from simgap.effects.effect import joint_scales
from simgap.effects.forces import CoulombFriction
from simgap.effects.inertia import LinkMass
from simgap.logs import JointLog, Logs, Motion, Signal
from simgap.next_motion import family
from simgap.next_motion.family import Plan, list_contacts, list_plans, make_motion
from simgap.next_motion.proposal import find_slopes, propose_motion
from simgap.next_motion.rivals import choose_rivals
from simgap.next_motion.separation import Slopes, choose_motion, find_deviations, find_sigma
from simgap.patch.patch import save_patch
from simgap.patch.text import read_rivals
from simgap.report.next_motion import next_document, next_lines, save_next_page
from simgap.result import Rival
from simgap.robot import ControlMode, Robot
from simgap.selection.fit import STEP

RANDOM = np.random.default_rng(5)
NOTHING: Slopes = (np.zeros((3, 0)), np.zeros((3, 0)))


def test_without_anything_to_fit_the_separation_is_the_distance_and_what_a_size_can_imitate_is_none():
    assert find_sigma(np.array([[1.0, 2.0, 0.0], [1.0, 0.0, 0.0]]), NOTHING, 0, 1) == pytest.approx(2.0)
    values, column = RANDOM.normal(size=(2, 50)), RANDOM.normal(size=(50, 1))
    values[1] = values[0] + 3.0 * column[:, 0]
    assert find_sigma(values, (1e6 * column, 1e6 * column), 0, 1) < 1e-3


def test_the_separation_is_that_of_a_fit_of_both_motions():
    """An independent oracle: the rival is fitted again to the earlier and the new motion together."""
    old, new, prior = RANDOM.normal(size=(30, 3)), RANDOM.normal(size=(20, 3)), np.array([2.0, np.inf, 0.5])
    values = RANDOM.normal(size=(2, 20))
    slopes = new @ find_deviations(old, prior)
    every = np.vstack([old, new, np.diag(1.0 / prior)])
    wanted = np.concatenate([np.zeros(30), values[0] - values[1], np.zeros(3)])
    sizes, (left,), *_ = np.linalg.lstsq(every, wanted)
    error = STEP * np.linalg.norm(new @ sizes)  # of the derivatives
    assert find_sigma(values, (slopes, slopes), 0, 1) == pytest.approx(np.sqrt(left - error**2))


def test_slopes_are_those_of_a_parabola_for_any_part_of_a_standard_deviation():
    line, bend, share = RANDOM.normal(size=(3, 20)), RANDOM.normal(size=(3, 20)), np.array([1.0, 0.3, 1e-3])
    changes = np.concatenate([k * share[:, None] * line + share[:, None] ** 2 * bend for k in (1.0, -1.0)])
    np.testing.assert_allclose(find_slopes(changes, share), np.concatenate([line, bend]).T, rtol=1e-9)


def test_sizes_that_act_to_one_side_alone_separate_nothing():
    up = 1e3 * RANDOM.normal(size=(3, 40))
    slopes = find_slopes(np.concatenate([up, 0.0 * up]), np.full(3, 1e-6))
    assert find_sigma(np.stack([up[0], 0.0 * up[0]]), (slopes, slopes), 0, 1) < 1.0


def test_a_small_rest_of_what_sizes_imitate_separates_nothing():
    values, column = RANDOM.normal(size=(2, 50)), RANDOM.normal(size=(50, 1))
    values[1] = values[0] + 500.0 * column[:, 0] + np.eye(50)[0] * 10.0
    assert find_sigma(values, (1e6 * column, 1e6 * column), 0, 1) == 0.0


def test_the_choice_is_that_of_all_motions_though_derivatives_of_few_are_asked_for():
    predictions = [scale * RANDOM.normal(size=(3, 40)) for scale in np.linspace(0.02, 1.0, 60)]
    slopes = [[RANDOM.normal(size=(40, 2)) for _ in range(3)] for _ in predictions]
    asked: list[int] = []

    def differentiate(some):
        asked.extend(some)
        return [slopes[k] for k in some]

    def confused(k):
        pairs = [(0, 1), (0, 2), (1, 2)]
        sigmas = (find_sigma(predictions[k], slopes[k], *one) for one in pairs)
        return float(np.mean([norm.cdf(1.6449 - sigma) for sigma in sigmas]))

    choice = choose_motion(predictions, differentiate, (1.0, 1.0, 1.0))
    assert choice.motions[0] == min(range(60), key=confused)
    assert len(asked) < 60
    assert choice.tells_apart


def test_a_motion_that_a_rival_cannot_make_is_never_proposed():
    predictions = [np.array([[0.0, 0.0], [np.nan, 9.0]]), np.array([[0.0, 0.0], [3.0, 0.0]])]
    choice = choose_motion(predictions, lambda some: [(np.zeros((2, 0)),) * 2 for _ in some], (1.0, 1.0))
    assert choice.motions == (1,)


def test_the_motion_tells_apart_what_is_in_doubt_not_what_earlier_motions_exclude():
    nothing = [(np.zeros((1, 0)),) * 3]
    predictions = [np.array([[0.0], [3.0], [0.0]]), np.array([[0.0], [1.0], [9.0]])]
    for chances, best in (((1.0, 0.4, 1e-3), 0), ((1.0, 0.4, 0.4), 1)):
        assert choose_motion(predictions, lambda some: nothing * len(some), chances).motions[0] == best


TIME_s = np.arange(0.0, 3.0, 0.01)
ROBOT = pendulum(kp=3.0, period_s=0.01)
PLANNED = tuple(motion(TIME_s, 0.0 * TIME_s, waves(TIME_s, seed), f"m{seed}") for seed in range(3))
EFFECTS = {one.key: one for one in (*catalogue(ROBOT, Logs(PLANNED)), *base_effects(ROBOT, Logs(PLANNED)))}
DELAY, LATE_LOG = EFFECTS["swing: command delay"], EFFECTS["swing: measurement delay"]
ZONE, PUSH = EFFECTS["swing: dead zone"], EFFECTS["swing: constant torque"]


LOGS = Logs(
    tuple(recorded(ROBOT, one, (DELAY, (0.02,)), noise_rad=3e-4, seed=k) for k, one in enumerate(PLANNED))
)


def rival(effect, size, p=0.3):
    base = base_effects(ROBOT, LOGS)
    sizes = (*((0.0,) * len(one.sizes) for one in base), (size,))
    return Rival(DELAY.key, effect.key, p, "simulation", (*base, effect), sizes, 1 + len(base))


def test_every_motion_stays_within_the_logs_and_begins_and_ends_at_rest():
    plans = list_plans(ROBOT, LOGS.fit, ["swing"], True)
    low, high = (find([find(one.joints["swing"].command.value) for one in LOGS.fit]) for find in (min, max))
    assert len(plans) > 20
    for plan in plans:
        command: Array = make_motion(ROBOT, plan, LOGS.fit[0]).joints["swing"].command.value
        assert low - 1e-9 <= command.min() < command.max() <= high + 1e-9
        assert np.ptp(command[:50]) == np.ptp(command[-50:]) == 0.0
        assert command[0] == command[-1]
        if plan.speed_rad_s < np.inf:
            assert np.max(np.abs(np.diff(command))) <= 1.01 * plan.speed_rad_s * 0.01


def test_a_motion_may_go_and_weigh_what_the_robot_file_calls_possible(tmp_path):
    number = '{ element = "body", name = "lower", attribute = "inertial/mass" }'
    weight = f'column = "gain"\nsets = [{number}]\npossible = [4.0, 5.0]'
    reach = 'mode = "position"\npossible_rad = [-1.5, 1.0]'
    text = ROBOT_FILE.replace('column = "gain"\n\n', f"{weight}\n\n").replace('mode = "position"', reach)
    robot = Robot.from_toml(write_robot(tmp_path, text=text))
    way = Signal(TIME_s, waves(TIME_s, 1))
    joints = {"shoulder": JointLog(position=way, command=way), "elbow": JointLog(position=way)}
    logs = [Motion(str(k), joints, {"shoulder": 1.0}, conditions={"gain": k}) for k in (2.0, 3.0)]
    plans = list_plans(robot, logs, ["shoulder"], False)
    assert {one.conditions["gain"] for one in plans} == {2.0, 3.0, 4.0, 5.0}
    ends = [one.ends_rad for one in plans]
    assert (min(low for low, _ in ends), max(high for _, high in ends)) == (-1.5, 1.0)


def test_power_goes_off_in_a_motion_only_if_it_does_in_the_logs():
    off = [with_signals(one, enabled=(TIME_s < 1.0) * 1.0) for one in LOGS.fit]
    assert all(plan.off_s == np.inf for plan in list_plans(ROBOT, LOGS.fit, ["swing"], True))
    assert all(plan.off_s == np.inf for plan in list_plans(ROBOT, off, ["swing"], False))
    plan = next(one for one in list_plans(ROBOT, off, ["swing"], True) if one.off_s < np.inf)
    assert ", without power from 5 s" in plan.describe(ROBOT)
    for logged in (off[0], LOGS.fit[0]):  # the first log may lack the column
        enabled = make_motion(ROBOT, plan, logged).joints["swing"].enabled
        assert [*enabled.value[[0, 499, 500, -1]]] == [1.0, 1.0, 0.0, 0.0]


def test_a_motion_is_made_as_cold_or_as_warm_as_the_logs_were():
    heats = zip(LOGS.fit, (25.0, 40.4, 30.0), strict=True)
    warming = [with_signals(one, temperature=heat + 0.0 * TIME_s) for one, heat in heats]
    plans = list_plans(ROBOT, warming, ["swing"], True)
    assert {one.temperatures_degC["swing"] for one in plans} == {25.0, 30.0, 40.0}
    made = make_motion(ROBOT, plans[0], warming[0]).joints["swing"].temperature
    assert {*made.value} == {*plans[0].temperatures_degC.values()}
    assert f"{made.value[0]:g} degC" in plans[0].describe(ROBOT)


@pytest.mark.usefixtures("few")
def test_a_motion_in_which_a_rival_is_faster_than_the_logs_is_never_proposed():
    slow = 0.3 * np.clip(0.5 * (TIME_s - 0.5), 0.0, 1.0)
    steps = 0.3 * (TIME_s > 0.5)
    logs = Logs(tuple(with_signals(one, position=slow, command=steps) for one in LOGS.fit))
    made, _ = propose_motion(ROBOT, logs, [rival(DELAY, 0.02, 1.0), rival(ZONE, 0.02)])
    assert any("in jumps" in one for one in made.motions)
    assert all("in jumps" not in made.motions[k] for k in made.choice.motions)


@pytest.mark.usefixtures("few")
def test_a_motion_in_which_any_rival_comes_to_a_limit_is_never_proposed():
    robot = pendulum(kp=3.0, period_s=0.01)
    robot.model.jnt_limited[0], robot.model.jnt_range[0] = True, (-2.0, 1.6)
    made, _ = propose_motion(robot, LOGS, [rival(DELAY, 0.02, 1.0), rival(PUSH, 1.0)])
    plans = list_plans(robot, LOGS.fit, ["swing"], True)
    assert any(one.ends_rad[1] > 1.2 for one in plans)
    assert all(plans[k].ends_rad[1] < 1.2 for k in made.choice.motions)
    assert np.isfinite(made.curves[0].values).all()  # a fast start, which is not compared, is not drawn


def test_a_pose_beyond_the_range_of_a_joint_counts_as_a_contact():
    robot = pendulum()
    robot.model.jnt_limited[0], robot.model.jnt_range[0] = True, (-1.0, 1.0)
    assert not list_contacts(robot, np.array([[-0.9], [0.9]]))
    assert list_contacts(robot, np.array([[0.0], [1.1]])) == {(-1, 0)}


@pytest.fixture
def few(monkeypatch):
    """Compare few motions, which takes less time."""
    monkeypatch.setattr(family, "MOST", 12)


@pytest.mark.usefixtures("few")
def test_a_delay_and_a_dead_zone_are_told_apart_and_the_page_shows_a_band_for_each(tmp_path):
    proposal, log = propose_motion(ROBOT, LOGS, [rival(DELAY, 0.02, 1.0), rival(ZONE, 0.02, 0.01)])
    assert proposal.choice.tells_apart
    assert proposal.choice.motions[0] == int(log.name)
    assert next_lines(proposal)[0].startswith("Record 4 times: swing from ")
    assert json.dumps(next_document(proposal), allow_nan=False)
    save_next_page(proposal, tmp_path / "next.html", None)
    text = (tmp_path / "next.html").read_text()
    assert text.count("<polygon") == 2 * len(proposal.curves) == 2
    assert proposal.is_sure
    assert "at 95 %: the motion is a check" in text


@pytest.mark.slow
def test_a_late_command_and_a_late_log_of_one_joint_are_the_same_in_every_motion():
    proposal, _ = propose_motion(ROBOT, LOGS, [rival(DELAY, 0.02, 1.0), rival(LATE_LOG, 0.02)])
    assert np.max(proposal.choice.sigmas) < 0.1
    assert not proposal.choice.tells_apart
    assert next_lines(proposal)[0].startswith("None of ")


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_torques_are_compared_along_the_motion_though_no_command_is_known():
    logs = Logs(tuple(two_joint_arm.simulated(two_joint_arm.arm(), seed, noise_rad=1e-5) for seed in (1, 2)))
    logs = Logs(tuple(replace(one, name=str(k)) for k, one in enumerate(logs.motions)))
    robot, ranges = two_joint_arm.arm(), joint_scales(two_joint_arm.arm(), logs.motions)
    friction, weight = CoulombFriction.at(robot, "elbow", ranges), LinkMass("elbow", 2.0)
    rivals = [
        Rival("elbow: Coulomb friction", one.key, 0.5, "inverse dynamics", (one,), ((size,),), 1)
        for one, size in ((friction, 0.5), (weight, 0.1))
    ]
    proposal, log = propose_motion(robot, logs, rivals)
    assert proposal.choice.tells_apart
    assert all(one.command is None for one in log.joints.values())
    assert {one.signal for one in proposal.curves} == {"elbow"}


def test_a_finding_without_a_rival_and_a_joint_that_takes_torques_get_no_motion():
    with pytest.raises(RobotError, match="no motion is needed"):
        choose_rivals([rival(DELAY, 0.02)])
    with pytest.raises(RobotError, match="joint swing: is commanded by torque"):
        list_plans(pendulum(ControlMode.TORQUE), LOGS.fit, ["swing"], True)


def test_the_finding_in_most_doubt_has_the_most_probable_rival_whichever_comes_first():
    sure, late = rival(DELAY, 0.02, 1.0), replace(rival(DELAY, 0.02, 1.0), finding=LATE_LOG.key)
    back = [replace(rival(ZONE, 5e-5, p), finding=late.finding) for p in (0.08, 0.5)]
    assert choose_rivals([sure, rival(ZONE, 5e-5, 0.2), late, *back])[0].finding == LATE_LOG.key
    with pytest.raises(RobotError, match="no finding has a rival"):
        choose_rivals([])


def test_the_rivals_of_a_diagnosis_are_read_again_with_their_sizes(tmp_path):
    rivals = (rival(DELAY, 0.02, 1.0), rival(ZONE, 5e-5))
    found = diagnosis(effects=rivals[0].effects, sizes=rivals[0].sizes, rivals=rivals)
    save_patch(ROBOT, found, tmp_path)
    with pytest.raises(
        RobotError, match=r"motions were fitted .*: give the logs and the held-out motions of"
    ):
        read_rivals(ROBOT, tmp_path, ["other"])
    for one, kept in zip(read_rivals(ROBOT, tmp_path, found.fitted_motions), rivals, strict=True):
        assert replace(one, effects=()) == replace(kept, effects=())
        assert [each.key for each in one.effects] == [each.key for each in kept.effects]
    path = tmp_path / "effects.toml"
    text = path.read_text()
    for old in ('kind = "', 'finding = "', 'effect = "swing'):
        path.write_text(text.replace(old, f"{old}x"))
        with pytest.raises(RobotError, match=r"not 'xsimulation'|has the key '(xswing|swingx)"):
            read_rivals(ROBOT, tmp_path, found.fitted_motions)


def test_commands_have_the_columns_and_units_of_the_logs(tmp_path):
    power = 'enabled = { column = "on", unit = "flag" }\n\n[joints.elbow]'
    robot = Robot.from_toml(write_robot(tmp_path, text=ROBOT_FILE.replace("[joints.elbow]", power)))
    time_s, on = np.array([0.0, 0.01]), Signal(np.array([0.0, 0.01]), np.array([1.0, 0.0]))
    position = JointLog(position=Signal(time_s, np.array([0.5, 0.6])))
    joints = {"shoulder": replace(position, command=position.position, enabled=on), "elbow": position}
    planned = Motion("next", joints, {"shoulder": 3.0, "elbow": 1.0}, conditions={"gain": 3.0})
    first, second = csv.DictReader(command_table(robot, planned).splitlines())
    assert first["motion"] == "next"
    assert float(second["t"]) == pytest.approx(10.0)  # ms
    assert float(second["c1"]) == pytest.approx(np.degrees(0.6))
    assert float(first["q2"]) == pytest.approx(0.5 * 50.0 * 4096.0 / (2.0 * np.pi))
    assert float(first["gain"]) == 3.0
    assert [first["on"], second["on"]] == ["1", "0"]


def test_a_command_file_has_the_format_and_the_times_of_the_logs(tmp_path):
    clock = ('column = "c1", unit', 'column = "c1", time_column = "tc", unit')
    robot = Robot.from_toml(write_robot(tmp_path, clock, text=f"{ROBOT_FILE}\n[csv]\ndecimal = ','\n"))
    way = JointLog(position=Signal(np.array([0.0, 0.01]), np.array([0.5, 0.6])))
    joints = {"shoulder": replace(way, command=way.position), "elbow": way}
    text = command_table(robot, Motion("next", joints, {"shoulder": 3.0}, conditions={"gain": 3.0}))
    first, second = csv.DictReader(text.splitlines(), delimiter=";")
    assert float(first["c1"].replace(",", ".")) == pytest.approx(np.degrees(0.5))
    assert "," in first["c1"]
    assert second["tc"] == second["t"] == "10"


def test_joints_that_share_a_column_of_power_lose_it_together_and_runs_of_a_motion_are_repeats(tmp_path):
    power = 'enabled = { column = "on", unit = "flag" }\n'
    text = ROBOT_FILE.replace("[joints.elbow]", f"{power}\n[joints.elbow]\n{power}")
    text = text.replace('columns = ["motion"]', 'columns = ["motion"]\nrepeat_column = "repeat"')
    robot, zeros = Robot.from_toml(write_robot(tmp_path, text=text)), Signal(TIME_s, 0.0 * TIME_s)
    log = JointLog(position=zeros, command=zeros, enabled=zeros)
    logged = Motion("m", {"shoulder": log, "elbow": log}, {"shoulder": 3.0}, conditions={"gain": 3.0})
    plan = Plan("shoulder", (0.0, 1.0), 1.0, 0.5, {"elbow": 0.0}, logged.gain, logged.conditions, {}, 5.0)
    first, *_, last = csv.DictReader(command_table(robot, make_motion(robot, plan, logged)).splitlines())
    assert (first["on"], last["on"], first["repeat"]) == ("1", "0", "next")


def test_a_folder_without_a_result_is_refused_and_nothing_is_written(tmp_path):
    write_robot(tmp_path)
    write_csv(tmp_path)
    before = snapshot(tmp_path)
    ran = run_simgap(tmp_path, "next", "robot.toml", "log.csv", "--start", ".", "--out", "next.csv")
    assert ran.returncode == 2
    assert "has no effects.toml; give the folder of a patch" in ran.stderr
    assert snapshot(tmp_path) == before

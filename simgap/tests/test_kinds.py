"""Kinds of residual, and the effects that each can show; currents that stand for torques."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.robot_folder import write_csv, write_robot
from helpers.two_joint_arm import arm, simulated
from helpers.verdicts import Rub, diagnosis
from simgap import diagnose
from simgap.assemble import list_base
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.command.check import simulate_nominal
from simgap.common.errors import RobotError
from simgap.effects.actuation import CurrentScale, GainError
from simgap.effects.command import MeasurementDelay
from simgap.effects.effect import Family, joint_scales
from simgap.loading import load, take_currents_as_torques
from simgap.logs import Logs, Signal
from simgap.patch.patch import make_patch
from simgap.report.traces import trace_motions
from simgap.residuals.simulation_residuals import list_kinds
from simgap.robot import Robot
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.joint_fits import fit_base
from simgap.simulation.compiled import Models


def with_commands(robot):
    """Return motions in which the logged torque was the command too."""
    found = [simulated(robot, seed, duration_s=2.0, name=f"m{seed}") for seed in range(4)]
    told = [{name: replace(log, command=log.torque) for name, log in one.joints.items()} for one in found]
    return [replace(one, joints=joints) for one, joints in zip(found, told, strict=True)]


@pytest.fixture(scope="module")
def unloaded():
    robot = arm(is_loaded=False)
    return robot, with_commands(robot)


def test_logged_torques_show_no_change_of_the_controller(unloaded):
    robot, motions = unloaded
    logs = Logs(tuple(motions))
    (kind,) = list_kinds(robot, motions, None)
    assert any(isinstance(one, GainError) for one in base_effects(robot, logs))
    for effect in (*base_effects(robot, logs), *catalogue(robot, logs)):
        assert not (kind.shows(effect) and effect.family is Family.ACTUATION)


def test_logged_torques_give_friction_a_scale_without_gravity(unloaded):
    robot, motions = unloaded
    (kind,) = list_kinds(robot, motions, None)
    base = [one for one in base_effects(robot, Logs(tuple(motions))) if kind.shows(one)]
    context, present = fit_base(start_context(kind.make(motions, True), base, (), 1, Meter()))
    assert all(one.is_identifiable for one in list_base(robot, context, present, []))


def test_traces_show_the_residuals_that_the_verdict_is_about(unloaded):
    robot, motions = unloaded
    found = diagnosis(kind="inverse dynamics", effects=(), sizes=())
    traces = trace_motions(robot, motions, found)
    shown = {(one.joint, one.kind, one.unit) for one in traces}
    assert shown == {(joint.name, "inverse dynamics", "N m") for joint in robot.joints}
    assert all(one.measured is None and one.explained.any() for one in traces)


def test_what_a_second_encoder_reads_is_no_part_of_a_patch(unloaded):
    robot, motions = unloaded
    late, other = MeasurementDelay.at(robot, "shoulder", joint_scales(robot, motions)), Rub("shoulder")
    kinds = {"effect_kinds": ("simulation", "second encoder", "second encoder")}
    kinds["kind"] = "simulation and second encoder"
    found = diagnosis(effects=(late, late, other), sizes=((0.015,), (0.003,), (0.2,)), **kinds)
    assert found.fitted_to("second encoder") == ((late, other), ((0.003,), (0.2,)))
    assert found.of_model() == ((late, other), ((0.015,), (0.2,)))


def test_a_joint_with_a_command_alone_makes_the_commands_simulated(unloaded):
    robot, motions = unloaded
    first = robot.joints[0].name
    cut = [(one, replace(one.joints[first], torque=None)) for one in motions]
    mixed = [replace(one, joints=one.joints | {first: log}) for one, log in cut]
    assert [kind.name for kind in list_kinds(robot, mixed, None)] == ["simulation"]
    assert [kind.name for kind in list_kinds(robot, motions, None)] == ["inverse dynamics"]


ELBOW = 'torque = { column = "m2", unit = "mN m", side = "motor" }'
CURRENT = 'current = { column = "m2", unit = "mA" }\ntorque_constant_Nm_A = 2.5'


@cache
def motion(seed):
    return simulated(arm(), seed, noise_rad=1e-5, name=f"m{seed}")


def guessed(constant_Nm_A, true_Nm_A, is_known, count):
    """Return the arm and its logs, in which torques are known as currents."""
    robot = arm()
    guess = {"torque_constant_Nm_A": constant_Nm_A, "torque_constant_is_known": is_known}
    robot = replace(robot, joints=tuple(replace(one, **guess) for one in robot.joints))
    motions = []
    for one in map(motion, range(count)):
        joints = {
            name: replace(log, torque=None, current=Signal(log.torque.time_s, log.torque.value / true_Nm_A))
            for name, log in one.joints.items()
        }
        motions.append(take_currents_as_torques(robot, replace(one, joints=joints)))
    return robot, motions


def test_a_current_with_its_constant_is_read_as_a_torque(tmp_path):
    path = write_robot(tmp_path, (ELBOW, CURRENT))
    log = load(path, write_csv(tmp_path)).motions[0].joints["elbow"]
    assert np.array_equal(log.torque.value, 2.5 * log.current.value)
    without = load(write_robot(tmp_path, (ELBOW, CURRENT.split("\n")[0])), tmp_path / "log.csv")
    assert without.motions[0].joints["elbow"].torque is None


def test_no_gain_is_asked_where_torques_are_compared(tmp_path):
    gains = ('gain_column = "gain"\nkp_Nm_rad = 15.0\n', "")
    shoulder = ("[joints.elbow]", 'torque = { column = "m2", unit = "N m" }\n\n[joints.elbow]')
    path = write_robot(tmp_path, gains, shoulder, (ELBOW, ""))
    text = (tmp_path / "model.xml").read_text()
    model = text.replace('kp="30" kv="2" ', "").replace("<position ", "<motor ")
    (tmp_path / "model.xml").write_text(model)
    robot = Robot.from_toml(path)
    assert math.isnan(robot.joint("shoulder").kp_Nm_rad)
    logs = load(robot, write_csv(tmp_path))
    assert [one.name for one in list_kinds(robot, logs.motions, None)] == ["inverse dynamics"]
    assert math.isnan(simulate_nominal(Models(robot), logs.motions[0]).mean_abs_rad["shoulder"])
    assert '<motor name="shoulder"' in make_patch(robot, [], []).model_xml  # it keeps what it has
    path.write_text(path.read_text().replace('torque = { column = "m2", unit = "N m" }\n', ""))
    with pytest.raises(RobotError, match=r"joints.shoulder.kp_Nm_rad: is 0 or missing"):
        Robot.from_toml(path)


@pytest.mark.parametrize("more", ["", 'current = { column = "m2", unit = "mA" }\n'])
def test_a_guess_without_a_current_in_place_of_a_torque_or_without_a_number_is_refused(tmp_path, more):
    guess = "torque_constant_is_known = false"
    with pytest.raises(RobotError, match="torque_constant_is_known: counts where a current stands for"):
        Robot.from_toml(write_robot(tmp_path, (ELBOW, f"{ELBOW}\n{more}{guess}")))
    text = CURRENT.split("\n")[0] + f"\n{guess}"
    with pytest.raises(RobotError, match=r"torque_constant_Nm_A: is missing; with torque_constant_is_known"):
        Robot.from_toml(write_robot(tmp_path, (ELBOW, text)))


def test_the_scale_of_a_current_is_a_base_parameter_only_if_it_is_a_guess():
    for is_known in (True, False):
        robot, motions = guessed(10.0, 10.0, is_known, 1)
        logs = Logs(tuple(motions))
        found = [one for one in base_effects(robot, logs) if isinstance(one, CurrentScale)]
        assert [one.place for one in found] == ([] if is_known else ["shoulder", "elbow"])
        assert not any(isinstance(one, CurrentScale) for one in catalogue(robot, logs))


@pytest.mark.slow
def test_a_wrong_scale_of_a_current_is_found():
    robot, motions = guessed(10.0, 10.8, False, 6)
    result = diagnose(robot, motions)
    scale = {one.place: one for one in result.base if one.name == "torque_constant_Nm_A"}
    for place in ("shoulder", "elbow"):
        assert scale[place].nominal == 10.0
        assert scale[place].value == pytest.approx(10.8, rel=0.02)
    assert result.findings == ()

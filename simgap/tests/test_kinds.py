"""Kinds of residual, and the effects that each can show."""

from dataclasses import replace

import pytest

from helpers.two_joint_arm import arm, simulated
from helpers.verdicts import Rub, diagnosis
from simgap.assemble import list_base
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.effects.actuation import GainError
from simgap.effects.command import MeasurementDelay
from simgap.effects.effect import Family, joint_scales
from simgap.logs import Logs
from simgap.report.traces import trace_motions
from simgap.residuals.simulation_residuals import list_kinds
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.joint_fits import fit_base


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

"""What was put into a synthetic twin of the SO-101 is found: gains and friction, also of the load."""

from dataclasses import replace

import pytest

from helpers.so101_twin import Truth, record, smooth_command, so101, with_locked_joints
from simgap.assemble import list_base
from simgap.catalogue.catalogue import base_effects
from simgap.diagnosis import diagnose
from simgap.logs import Logs
from simgap.residuals.simulation_residuals import SimulationResiduals
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.joint_fits import fit_base

LIFT, ELBOW, ROLL = "shoulder_lift", "elbow_flex", "wrist_roll"
REACH_rad = {LIFT: 0.3, ELBOW: 0.4}


@pytest.mark.slow
def test_base_parameters_of_the_twin_are_found():
    truth = Truth(gain_ratio={LIFT: 0.4, ELBOW: 0.15}, coulomb_Nm={LIFT: 0.39})
    robot = so101()
    sent = [smooth_command(robot, k, 3.0, REACH_rad) for k in range(4)]
    motions = [record(robot, truth, f"smooth {k}", one, k) for k, one in enumerate(sent)]
    joints = tuple(replace(one, is_known=one.name not in truth.gain_ratio) for one in robot.joints)
    unknown = replace(robot, joints=joints)
    raw = SimulationResiduals(unknown, motions, n_threads=1)
    base = base_effects(unknown, Logs(tuple(motions)))
    context, present = fit_base(start_context(raw, base, (), 1, Meter()))
    found = {(one.place, one.name): one.value for one in list_base(unknown, context, present, ())}
    for key, value in {
        (LIFT, "gain_ratio"): 0.4,
        (ELBOW, "gain_ratio"): 0.15,
        (LIFT, "coulomb_Nm"): 0.052 + 0.39,
        (ELBOW, "coulomb_Nm"): 0.052,
    }.items():
        assert found[key] == pytest.approx(value, abs=0.01), key


@pytest.mark.slow
def test_load_dependent_friction_of_the_lift_is_named_beside_gain_errors():
    truth = Truth(gain_ratio={LIFT: 0.4, ELBOW: 0.15}, friction_per_load={LIFT: 0.7})
    robot = with_locked_joints(so101(), (LIFT, ELBOW))
    sent = [smooth_command(robot, k, 4.0, REACH_rad) for k in range(10)]
    motions = [record(robot, truth, f"smooth {k}", one, k) for k, one in enumerate(sent)]
    result = diagnose(robot, motions[:7], held_out=motions[7:], seed=1)
    (finding,) = result.findings
    assert (finding.place, finding.effect) == (LIFT, "load-dependent friction")
    assert finding.size[0] == pytest.approx(0.7, rel=0.25)  # as close as two halves of the real arm must be
    base = {(one.place, one.name): one.value for one in result.base}
    assert base[LIFT, "gain_ratio"] == pytest.approx(0.4, abs=0.02)
    assert base[ELBOW, "gain_ratio"] == pytest.approx(0.15, abs=0.02)
    error = {one.joint: one for one in result.errors}
    assert error[LIFT].explained < 0.25 * error[LIFT].base

"""Every event describes itself in one sentence; every event and every command has a test."""

import ast
import typing
from dataclasses import fields
from functools import cache
from pathlib import Path

import pytest

from fsw.dictionary import commands, evrs, faults
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import Evr, Severity

EVRS = [
    kind
    for kind in (vars(evrs) | vars(faults)).values()
    if isinstance(kind, type) and issubclass(kind, Evr) and kind not in (Evr, faults.Fault)
]
COMMANDS = typing.get_args(commands.Command)
TESTS = Path(__file__).parents[1]
ELSEWHERE = {evrs.SoftwareError}
"""Events of the loop around flight software, which is tested there."""

SENTENCES = {
    evrs.Booted("ab12"): "flight software up, parameters ab12",
    evrs.CommandAccepted("Stop"): "Stop accepted",
    evrs.CommandCompleted("Stop"): "Stop completed",
    evrs.CommandRefused("Unstow", "no"): "Unstow refused: no",
    evrs.CommandAborted("Retract"): "Retract aborted",
    evrs.ModeChanged(Mode.STOWED, Mode.FREE_SPACE): "mode STOWED -> FREE_SPACE",
    evrs.JointCalibrated(Joint.ELBOW, -0.0012, 31.5, 15.2, 0.0037, True): (
        "ELBOW calibrated: zero moved by -0.001200 rad, runs with 31.5 N m, "
        "hardstop and gear give 15.20 urad per N m, backlash 0.003700 rad (measured: True)"
    ),
    faults.StalledEarly(
        Joint.WRIST, -3.1, -3.35
    ): "WRIST stalled at -3.1000 rad, its hardstop is at -3.3500 rad",
    faults.HardstopMissed(
        Joint.WRIST, -3.38, -3.35
    ): "WRIST is at -3.3800 rad and met no hardstop at -3.3500 rad",
    faults.HardstopImplausible(Joint.TURRET, 90.0, 25.0): (
        "TURRET is pressed on something that gives 90.00 urad per N m, a hardstop gives 25.00"
    ),
    faults.HardstopMoved(
        Joint.AZIMUTH, 0.003, 0.002
    ): "AZIMUTH: its hardstop moved by 0.003000 rad, bound 0.002000 rad",
    faults.MotorStuck(Joint.TURRET, 0.01, 0.8): "TURRET does not turn at 0.01 A, limit 0.80 A",
    faults.CurrentImplausible(
        Joint.ELBOW, 4.0, 1.5
    ): "ELBOW reads 4.00 A, which cannot be at a limit of 1.50 A",
    faults.HardstopUnclear(Joint.ELBOW): "ELBOW stalled where no hardstop can be told from its current",
    faults.ResolverDisagrees(
        Joint.ELEVATION, -0.006, 0.0055
    ): "ELEVATION: resolver off by -0.00600 rad, bound 0.00550 rad",
    evrs.BranchChosen("apxs", "b"): "apxs: branch b",
    evrs.ContactMade("apxs_1", 0.1): "contact on apxs_1 after 0.1000 m",
    faults.SensorNotFinite("current_A"): "non-finite reading in current_A",
    faults.StructureTemperatureImplausible(90.04, -130.0, 70.0): (
        "structure reads 90.0 degC, bounds -130.0 .. 70.0 degC"
    ),
    faults.GravityImplausible(25.04, 1.0, 20.0): "gravity reads 25 m/s2, bounds 1 .. 20 m/s2",
    faults.SetpointUnsafe(Joint.ELBOW, 2.9, 2.8): "ELBOW: set-point 2.9000 rad held back, last 2.8000 rad",
    faults.SoftLimitPassed(Joint.ELBOW, 2.9, 2.8): "ELBOW at 2.9000 rad, soft limit 2.8000 rad",
    faults.OverCurrent(Joint.WRIST, -2.9, 2.85): "WRIST drew -2.90 A, bound 2.85 A",
    faults.FollowingErrorHigh(
        Joint.TURRET, 0.003, 0.002
    ): "TURRET is 0.00300 rad from its set-point, bound 0.00200 rad",
    faults.ContactInFreeSpace("drt_2"): "contact on drt_2 in free space",
    faults.UnexpectedContact(
        Joint.ELBOW, 63.4, 52.4
    ): "unexpected contact: ELBOW resists with 63 N m, about 52 N at the tool",
    faults.NoContact(0.15): "no contact within 0.1500 m of guarded travel",
    faults.NotSettled(Joint.AZIMUTH, 1e-4): "AZIMUTH not settled: 0.000100 rad from its set-point",
    faults.MotorStalled(Joint.ELBOW, 0.0, -0.01): (
        "ELBOW stalled: turns at 0.00000 rad/s, asked for -0.01000 rad/s"
    ),
    faults.OverTemperature(Joint.WRIST, 95.04, 90.0): "WRIST: winding at 95.0 degC, bound 90.0 degC",
    faults.UnderTemperature(Joint.WRIST, -75.0, -70.0): "WRIST: winding at -75.0 degC, bound -70.0 degC",
    faults.SensorFrozen("current_A", 64): "current_A reads the same for 64 cycles",
    faults.CyclesMissed(9, 4): "9 cycles missed, at most 4 are tolerated",
    faults.CycleCountWrong(7, 57): "cycle count 7 after 57, it must rise",
    faults.TiltChanged(0.0123, 0.01): "gravity turned by 0.0123 rad, bound 0.0100 rad",
    faults.ContactLost("drill"): "drill lost contact",
    faults.PreloadOutside("drill", 300.0, -120.04, 100.0): (
        "force on drill off by -120.0 N from 300.0 N, bound 100.0 N"
    ),
    evrs.CyclesSkipped(3): "3 cycles missed",
    evrs.FaultResponse("BRAKE_AND_REFUSE"): "response BRAKE_AND_REFUSE",
    evrs.FaultCleared(): "fault cleared",
    evrs.Preloaded("drill", 300.0): "drill pressed with 300.0 N",
    evrs.PreloadMissed("drill", 262.04, 300.0, "3 corrections did not reach the force"): (
        "drill is pressed with about 262.0 N of 300.0 N: 3 corrections did not reach the force"
    ),
    evrs.ForceEstimated("drill", 0.9123, 0.1): (
        "drill: a newton of the model is 0.912 N along its axis, 0.100 N across"
    ),
    evrs.SpotSet("apxs", 2.0, -0.1, 0.85): "spot of apxs at 2.0000 -0.1000 0.8500 m in RMECH",
    evrs.ParamSet("collision.ground_z_m", 1.25, "ab12"): "collision.ground_z_m is 1.25, parameters ab12",
    evrs.TiltSet(0.0012): "tilt set, 0.0012 rad from what the IMU reads",
    evrs.SoftwareError("KeyError: 'a'"): "software error: KeyError: 'a'",
}


@pytest.mark.parametrize(("evr", "sentence"), SENTENCES.items(), ids=lambda v: getattr(v, "name", ""))
def test_every_event_reads_as_a_sentence(evr, sentence):
    assert evr.message == sentence


def test_a_contact_without_a_lever_tells_its_torque_only():
    contact = faults.UnexpectedContact(Joint.ELBOW, 63.4, 0.0)
    assert contact.message == "unexpected contact: ELBOW resists with 63 N m"


def test_no_event_is_without_its_sentence():
    assert {type(evr) for evr in SENTENCES} == set(EVRS)


@pytest.mark.parametrize("kind", EVRS)
def test_every_event_has_a_severity_and_names_only_its_own_fields(kind):
    assert isinstance(kind.severity, Severity)
    named = {part.split(".")[1] for part in kind.text.replace("}", "{").split("{")[1::2]}
    named = {name.split(":")[0] for name in named}
    assert named == {field.name for field in fields(kind)}


@cache
def used() -> set[str]:
    """Collect the names in the code of the other tests, without imports, comments and strings."""
    trees = [ast.parse(path.read_text()) for path in TESTS.rglob("*.py") if path != Path(__file__)]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return names | {node.attr for node in nodes if isinstance(node, ast.Attribute)}


@pytest.mark.parametrize("kind", [kind for kind in EVRS if kind not in ELSEWHERE] + list(COMMANDS))
def test_every_event_is_provoked_and_every_command_given_somewhere(kind):
    assert kind.__name__ in used()

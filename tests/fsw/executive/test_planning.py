"""Planning: piece by piece, on the brakes, in a mode of its own."""

import pickle

import numpy as np
import pytest

from fsw.cycle import step
from fsw.dictionary import commands
from fsw.dictionary.commands import MoveJoints, MoveTool, Stop
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import (
    CommandAborted,
    CommandAccepted,
    CommandCompleted,
    CommandRefused,
    FaultResponse,
)
from fsw.motion.work import Work, complete
from fsw.state import boot
from tests.fsw.executive import lab
from tests.fsw.executive.lab import COMMANDS, TOUCHED
from tests.fsw.rig import Rig, content, floats, quiet_sensors

MOTIONS = [
    kind
    for kind in COMMANDS
    if kind
    not in (
        *(commands.Calibrate, commands.CalibrateAll, commands.SetTilt, commands.SetParam),
        *(commands.Stop, commands.ClearFault),
    )
]
"""Commands that are planned."""


def ready_for(kind) -> tuple[Rig, dict]:
    """A rig in which a command is accepted, and its readings."""
    if kind is commands.Unstow:
        return lab.stowed(), {}
    if kind in (commands.Preload, commands.ToolChange):
        return lab.guarded_in_contact(), TOUCHED
    return lab.deployed(), {}


def planning(kind) -> tuple[Rig, dict]:
    rig, readings = ready_for(kind)
    rig.evrs.clear()
    rig.cycle(COMMANDS[kind](rig), **readings)
    return rig, readings


@pytest.mark.parametrize("kind", MOTIONS)
def test_a_command_is_planned_on_the_brakes_before_it_is_accepted(kind):
    rig, readings = planning(kind)
    cycles = 0
    while rig.state.planning is not None and rig.state.sequence is None:
        assert rig.outputs.joint.mode is Mode.PLANNING
        assert rig.outputs.joint.busy
        assert not rig.outputs.drive.power_on.any()
        assert not rig.outputs.drive.brake_release.any()
        assert CommandAccepted(kind.__name__) not in rig.evrs
        rig.cycle(**readings)
        cycles += 1
    assert cycles > 1
    assert CommandAccepted(kind.__name__) in rig.evrs


@pytest.mark.parametrize("kind", MOTIONS)
def test_what_is_planned_piece_by_piece_is_what_is_planned_at_once(kind):
    rig, readings = planning(kind)
    whole = complete(rig.config, rig.state.planning.work)
    work = rig.state.planning.work
    while isinstance(rig.state.planning and rig.state.planning.work, Work) and rig.state.sequence is None:
        work = rig.state.planning.work
        rig.cycle(**readings)
    assert content(work.advance(rig.config)) == content(whole)


@pytest.mark.parametrize("kind", MOTIONS)
def test_a_run_that_goes_on_from_a_state_that_was_written_in_mid_planning_is_the_same(kind):
    rig, readings = planning(kind)
    for _ in range(3):
        rig.cycle(**readings)
        ahead, other = rig.fork(), rig.fork()
        other.state = pickle.loads(pickle.dumps(rig.state))
        assert content(ahead.begin(**readings)) == content(other.begin(**readings))
        assert content(ahead.state.move) == content(other.state.move)


@pytest.mark.parametrize("kind", MOTIONS)
def test_a_stop_ends_the_planning_and_leaves_the_arm_as_it_was(kind):
    rig, readings = ready_for(kind)
    mode = rig.state.mode
    rig.evrs.clear()
    rig.cycle(COMMANDS[kind](rig), **readings)
    rig.cycle(**readings)
    rig.cycle(Stop(), **readings)
    assert (rig.state.mode, rig.state.planning, rig.state.move) == (mode, None, None)
    assert not rig.outputs.joint.busy
    ended = [evr for evr in rig.evrs if isinstance(evr, CommandAborted | CommandCompleted | CommandAccepted)]
    assert ended == [CommandAborted(kind.__name__), CommandCompleted("Stop")]


def test_a_stop_while_a_step_is_planned_aborts_its_sequence():
    rig, _ = planning(commands.PlaceTool)
    while rig.state.sequence is None or rig.state.planning is None:
        rig.cycle()
    rig.evrs.clear()
    rig.cycle(Stop())
    assert not rig.outputs.joint.busy
    assert [evr for evr in rig.evrs if isinstance(evr, CommandAborted)] == [CommandAborted("PlaceTool")]
    assert rig.state.mode is Mode.DEPLOYED


@pytest.mark.parametrize("trouble", [{"switch_closed": [True] + [False] * 9}, {"winding_C": [150.0] * 5}])
def test_a_fault_ends_the_planning(trouble):
    rig, _ = planning(commands.PlaceTool)
    while not any(isinstance(evr, FaultResponse) for evr in rig.evrs):
        rig.cycle(**trouble)
    rig.run()
    assert rig.state.mode is Mode.FAULTED
    assert rig.state.planning is None
    assert CommandAborted("PlaceTool") in rig.evrs
    assert CommandAccepted("PlaceTool") not in rig.evrs


def test_missed_cycles_end_the_planning_and_no_fault_stands():
    rig, _ = planning(MoveJoints)
    rig.cycles += rig.config.params.monitors.missed_cycles + 1
    rig.cycle()
    rig.cycle()  # the next count says that it was no wrong reading
    assert (rig.state.mode, rig.state.planning, rig.state.fault) == (Mode.DEPLOYED, None, None)
    assert CommandAborted("MoveJoints") in rig.evrs


def test_a_touching_tool_that_is_about_to_move_may_touch_while_its_move_is_planned():
    rig, readings = planning(commands.ToolChange)
    rig.begin(**readings)
    assert not any(isinstance(evr, FaultResponse) for evr in rig.evrs)


def test_a_plan_that_is_refused_leaves_the_arm_at_rest_in_its_mode():
    rig = lab.deployed()
    rig.evrs.clear()
    events = rig.run(MoveTool("apxs", (9.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    assert sum(isinstance(evr, CommandRefused) for evr in events) == 1
    assert rig.state.mode is Mode.DEPLOYED
    assert not rig.outputs.joint.busy


def test_the_arm_is_not_built_anew_while_it_is_planned_for():
    rig, _ = planning(MoveJoints)
    rig.warm_C += 40.0
    while rig.state.planning is not None:
        rig.cycle()
        assert rig.state.changed_config is None


def test_a_cycle_does_a_piece_of_the_plan_and_no_more():
    """Each piece is that of the work which the state holds, however long the plan is."""
    rig, _ = planning(commands.PlaceTool)
    for _ in range(10):
        expected = rig.state.planning.work.advance(rig.config)
        rig.cycle()
        assert content(rig.state.planning.work) == content(expected)


def test_a_plan_from_first_readings_that_the_next_contradict_is_given_up():
    rig = Rig(lab.CONFIG, start_rad=lab.START)
    rig.state, rig.cycles = boot(lab.CONFIG, Mode.DEPLOYED, rig.state.joints.reference), 0
    command = MoveJoints(floats(lab.START + 0.05))
    rig.cycle(command, gravity_R_m_s2=[0.0, 0.0, 9.81])
    rig.run()
    assert CommandAborted("MoveJoints") in rig.evrs
    assert CommandAccepted("MoveJoints") not in rig.evrs
    assert (rig.state.mode, rig.state.fault) == (Mode.DEPLOYED, None)


@pytest.mark.parametrize(("counts", "is_refused"), [(9, False), (10, True)])
def test_a_plan_is_refused_if_a_motor_has_crept_from_its_start(counts, is_refused):
    """Each step is one that a motor on its brake may make; together they are more than it is at rest."""
    rig, _ = planning(commands.PlaceTool)
    most = rig.config.params.motion.settle_error_rad / rig.config.rad_per_count[Joint.AZIMUTH]
    assert 9 < most < 10
    for _ in range(counts):
        rig.count = rig.count + (np.arange(5) == Joint.AZIMUTH)
        rig.cycle()
    rig.begin()
    refused = [evr.reason for evr in rig.evrs if isinstance(evr, CommandRefused)]
    assert bool(refused) is is_refused
    assert all(reason.startswith("azimuth has moved by 0.00003") for reason in refused)


def test_the_move_begins_where_the_motors_are():
    """A motor that its brake holds may be a count from where it was when planning began."""
    rig, _ = planning(MoveJoints)
    rig.count = rig.count + 1
    rig.begin()
    np.testing.assert_array_equal(rig.state.move.setpoint.motor_rad, rig.state.joints.motor_rad)
    rig.run()
    assert CommandCompleted("MoveJoints") in rig.evrs


def test_without_a_cycle_nothing_is_planned_and_a_cycle_reads_only_its_arguments():
    rig, _ = planning(MoveJoints)
    sensors = quiet_sensors(rig.count, cycle=rig.cycles + 1, resolver_rad=rig.resolver_rad())
    first, second = (step(rig.config, rig.state, sensors, ()) for _ in range(2))
    assert content(first) == content(second)

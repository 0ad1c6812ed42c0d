"""One control cycle: judge readings, estimate, decide, move, protect; sensors and commands give outputs."""

from dataclasses import replace

from fsw.config import CYCLE_S, Config, configure_at
from fsw.dictionary.arguments import Wrong, read_arguments
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Booted, Evr, ModeChanged
from fsw.dictionary.faults import ReadingImplausible
from fsw.estimate.joints import (
    JointEstimate,
    LoadEstimate,
    apply_calibration,
    begin_joints,
    locate_at_rest,
    no_load,
    note_braked,
    update_joints,
    update_load,
)
from fsw.executive.clearing import find_uncleared, refuse_clear, without_clear
from fsw.executive.commands import continue_planning, continue_sequence, handle
from fsw.executive.context import CommandContext, known_names, refuse
from fsw.executive.protection import MoveOutcome, apply_decision, describe_arm
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Outputs, Sensors, ToolChannels
from fsw.motion.move import ALL_JOINTS, Move, Phase, advance_move, command_actuators, move_preload
from fsw.motion.preload import PreloadState
from fsw.protect.monitors import protect
from fsw.protect.readings import ReadingState, judge, reading_channels
from fsw.state import State, joint_channels


def step(
    config: Config, state: State, sensors: Sensors, commands: tuple[Command, ...]
) -> tuple[State, Outputs]:
    """Compute one control cycle, from arguments alone; `state.changed_config` replaces that at boot.

    A fault that is found in the cycle in which it would be cleared is not cleared: the cycle is computed
    without that command, which is refused.
    """
    before, at_boot, config = state, config, state.changed_config or config
    turning = None if state.move is None else _get_turning(state.move)
    readings, used, found = judge(config.readings, state.readings, sensors, turning, state.drive)
    is_due = readings.history.begins or state.tick % config.params.motion.load_period_cycles == 0
    if is_due and readings.used:
        state = _follow_structure(config, state, used.structure_C, readings)
        config = state.changed_config or config
    joints, load, tool_channels = _estimate(config, state, used, readings)
    state, joints, decided = _decide(config, state, joints, load, used, commands, readings)
    if state.readings is not before.readings and state.readings is not readings:
        # the ground has ordered to use what is read
        readings = state.readings
        found = tuple(evr for evr in found if not isinstance(evr, ReadingImplausible))
    # without a move, the last set-point is the motor angle by the encoder zero of this cycle
    last_rad = joints.motor_rad if before.move is None else before.move.setpoint.motor_rad
    moved, joints, preload, backlash_rad = _move(config, state, joints, load, used, bool(readings.used))
    backlash_state = joints.backlash_state
    mode = moved.mode if state.planning is None else state.rest_mode
    arm = describe_arm(mode, state.tool, joints, backlash_state, moved.move, preload)
    monitors, decision = protect(
        config.protection, state.monitors, moved.fault, arm, used, readings, last_rad, found, moved.evrs
    )
    after = moved if decision is None else apply_decision(config, moved, decision, joints)
    # built once: a `replace` in each stage would copy all fields each time
    state = State(
        tick=before.tick + 1,
        mode=after.mode,
        tool=state.tool,
        joints=joints,
        load=load,
        planned_backlash_rad=backlash_rad,
        planning=after.planning,
        move=after.move,
        preload=preload,
        sequence=after.sequence,
        fault=after.fault,
        monitors=monitors,
        drive=command_actuators(config, after.move, joints, state.drive),
        structure_C=state.structure_C,
        structure_readings=state.structure_readings,
        surface=state.surface,
        changed_config=state.changed_config,
        readings=readings,
    )
    evrs = decided + after.evrs
    if commands and (fault := find_uncleared(evrs)) is not None:
        return refuse_clear(step(at_boot, before, sensors, without_clear(commands)), commands, fault)
    if before.tick == 0 or state.mode is not before.mode:
        evrs = _report_changes(at_boot, before, state, evrs)
    channels = joint_channels(before.tick, state, backlash_state)
    is_told = tool_channels is not None or readings.history is not before.readings.history
    validity = reading_channels(before.tick, readings) if is_told else None
    return state, Outputs(state.drive, channels, tool_channels, evrs, validity)


def _report_changes(at_boot: Config, before: State, state: State, evrs: tuple[Evr, ...]) -> tuple[Evr, ...]:
    """Report the first cycle and a change of the mode, beside the other events."""
    if before.tick == 0:
        evrs = (Booted(at_boot.params_sha256), *evrs)
    if state.mode is not before.mode:
        evrs = (*evrs, ModeChanged(before.mode, state.mode))
    return evrs


def _get_turning(move: Move) -> Flags:
    """Return the motors that may have turned since the last readings; brakes may not act yet."""
    return ALL_JOINTS if move.phase is Phase.BRAKE else move.plan.active


def _follow_structure(config: Config, state: State, reading_C: float, judged: ReadingState) -> State:
    """Filter the temperature of the structure, and let the arm grow with it while it is at rest.

    This is done in each load period; the filter begins with the mean of its first readings.
    """
    period_s = CYCLE_S * config.params.motion.load_period_cycles
    count = 1 if judged.history.begins else state.structure_readings + 1
    share = min(max(period_s / config.params.heat.filter_s, 1 / count), 1.0)
    structure_C = state.structure_C + share * (reading_C - state.structure_C)
    changed = state.changed_config
    # a plan, its move and its protection keep the arm that they began with
    is_kept = state.planning is not None or state.move is not None
    if not is_kept and abs(structure_C - config.structure_C) >= config.params.heat.step_K:
        changed = configure_at(config, structure_C)
    return replace(state, structure_C=structure_C, structure_readings=count, changed_config=changed)


def _estimate(
    config: Config, state: State, sensors: Sensors, readings: ReadingState
) -> tuple[JointEstimate, LoadEstimate, ToolChannels | None]:
    """Estimate joint angles in each cycle, load and tool pose in each load period.

    With unusable readings the last estimate stays; where readings begin, so does the estimate.
    """
    if not readings.used:
        return state.joints, state.load, None
    if readings.history.begins:
        state = replace(state, joints=begin_joints(config, state.joints), load=no_load(len(Joint)))
    joints = update_joints(config, state.joints, sensors)
    if state.load.known and state.tick % config.params.motion.load_period_cycles != 0:
        return joints, state.load, None
    push = None if state.preload is None else state.preload.reaction
    load, joints, channels = update_load(config, state.tick, state.tool, joints, state.load, push)
    return joints, load, channels


def _decide(
    config: Config,
    state: State,
    joints: JointEstimate,
    load: LoadEstimate,
    sensors: Sensors,
    commands: tuple[Command, ...],
    readings: ReadingState,
) -> tuple[State, JointEstimate, tuple[Evr, ...]]:
    """Handle the commands, go on with a plan, then begin the next step of a sequence that waits."""
    if not commands and state.planning is None and (state.sequence is None or state.move is not None):
        return state, joints, ()
    known = replace(state, joints=joints, load=load, readings=readings)
    context = CommandContext(known, readings.usable, closed=sensors.switch_closed)
    for command in commands:
        context = _receive(context.state.changed_config or config, context, command)
    # a command that has just arrived is planned from the next cycle on
    if context.state.planning is not None and context.state.planning is state.planning:
        context = continue_planning(config, context)
    context = continue_sequence(context.state.changed_config or config, context)
    return context.state, context.state.joints, context.evrs


def _receive(config: Config, context: CommandContext, command: Command) -> CommandContext:
    """Handle a command from the ground; return the context with what it changed, or why it is refused."""
    received = read_arguments(command, known_names(config.params))
    if isinstance(received, Wrong):
        return refuse(context, command, received.text)
    return handle(config, context, received)


def _move(
    config: Config, state: State, joints: JointEstimate, load: LoadEstimate, sensors: Sensors, usable: bool
) -> tuple[MoveOutcome, JointEstimate, PreloadState | None, Array]:
    """Advance the move by one cycle, before protection checks it.

    With unusable readings only the brake phase advances.
    """
    mode, move, preload, backlash_rad = state.mode, state.move, state.preload, state.planned_backlash_rad
    evrs: tuple[Evr, ...] = ()
    if move is not None and (usable or move.phase is Phase.BRAKE):
        result = advance_move(config, move, joints, load, sensors)
        if move.plan.preload_change is not None:
            preload = move_preload(result.move or move)
        last, move, evrs = move, result.move, result.evrs
        mode = mode if result.end_mode is None else result.end_mode
        backlash_rad = backlash_rad if result.backlash_rad is None else result.backlash_rad
        if result.found_hardstop is not None:
            joint, found = result.found_hardstop
            before, joints = joints, apply_calibration(config, joints, load.torque_Nm, joint, found)
            evrs = (found.to_event(joint, float((joints.motor_rad - before.motor_rad)[joint])), *evrs)
        joints = _locate_braked(config, last, move, joints)
    outcome = MoveOutcome(mode, state.planning, move, state.sequence, state.fault, evrs)
    return outcome, joints, preload, backlash_rad


def _locate_braked(config: Config, last: Move, move: Move | None, joints: JointEstimate) -> JointEstimate:
    """Locate the outputs inside their backlash by the resolvers where a move ends, brakes on.

    A move that was stopped may have been braked while its motors turned; the next one locates the outputs.
    """
    if last.plan.stopped:
        return joints
    if move is None:
        return locate_at_rest(config, joints)
    is_braked = move.phase is Phase.BRAKE and last.phase is not Phase.BRAKE
    return note_braked(joints) if is_braked else joints

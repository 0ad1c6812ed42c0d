"""One control cycle: sensors, commands -> estimate -> decide -> move -> protect -> drive, telemetry, evrs."""

from dataclasses import replace

from fsw.config import Config
from fsw.dictionary.channels import ToolChannels
from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import Booted, Evr, ModeChanged
from fsw.estimate import joints as joint_estimate
from fsw.estimate import load as load_estimate
from fsw.executive.commands import handle, proceed
from fsw.executive.situation import Situation
from fsw.kinematics.transforms import Array
from fsw.messages import Outputs, Sensors
from fsw.motion.drive import drive_for
from fsw.motion.move import Phase, advance, pressing_in
from fsw.protect.guard import Guarded, guard
from fsw.protect.monitors import MonitorState, watch
from fsw.protect.motors import lowest_for
from fsw.protect.readings import unusable
from fsw.protect.setpoints import unsafe_setpoint
from fsw.state import State, joint_channels, last_setpoint


def step(
    config: Config, state: State, sensors: Sensors, commands: tuple[Command, ...]
) -> tuple[State, Outputs]:
    """The state and the outputs after one cycle; everything follows from the arguments."""
    before, config = state, state.changed or config
    bad = unusable(config, sensors)
    state, tool_channels = _estimate(config, state, sensors, usable=not bad)
    state, decided = _decide(config, state, sensors, commands, usable=not bad)
    # at rest the last set-point is where the motors are, in today's encoder zero
    last_rad = state.joints.motor_rad if before.move is None else last_setpoint(before)
    state, moved = _move(config, state, sensors, usable=not bad)
    state, seen, found = _protect(config, state, sensors, last_rad, bad, moved)
    return _output(config, before, state, seen, tool_channels, decided + found)


def _estimate(
    config: Config, state: State, sensors: Sensors, usable: bool
) -> tuple[State, ToolChannels | None]:
    """Joint angles every cycle, load and tool pose every so often; bad readings leave the last estimate."""
    if not usable:
        return state, None
    joints = joint_estimate.update(config, state.joints, sensors)
    if state.load.known and state.tick % config.params.motion.load_period != 0:
        return replace(state, joints=joints), None
    push = None if state.pressing is None else state.pressing.pushed
    load, joints, channels = load_estimate.refresh(config, state.tick, state.tool, joints, state.load, push)
    return replace(state, joints=joints, load=load), channels


def _decide(
    config: Config, state: State, sensors: Sensors, commands: tuple[Command, ...], usable: bool
) -> tuple[State, tuple[Evr, ...]]:
    """Commands change what the arm is about to do."""
    if not commands and state.sequence is None:
        return state, ()
    now = Situation(state, usable, closed=sensors.switch_closed)
    for command in commands:
        now = handle(now.state.changed or config, now, command)
    now = proceed(now.state.changed or config, now)
    return now.state, now.evrs


def _move(config: Config, state: State, sensors: Sensors, usable: bool) -> tuple[State, tuple[Evr, ...]]:
    """The move under way, one cycle on; with bad readings only the brakes go on."""
    if state.move is None or not (usable or state.move.phase is Phase.BRAKE):
        return state, ()
    result = advance(config, state.move, state.joints, state.load.torque_Nm, sensors)
    mode = state.mode if result.end_mode is None else result.end_mode
    pressing = state.pressing
    if state.move.press is not None:
        pressing = pressing_in(result.move or state.move)
    state = replace(state, move=result.move, mode=mode, pressing=pressing)
    if result.stop is None:
        return state, result.evrs
    joint, found = result.stop
    joints = joint_estimate.calibrated(config, state.joints, state.load.torque_Nm, joint, found)
    moved_rad = float((joints.motor_rad - state.joints.motor_rad)[joint])
    return replace(state, joints=joints), (found.event(joint, moved_rad), *result.evrs)


def _protect(
    config: Config,
    state: State,
    sensors: Sensors,
    last_rad: Array,
    bad: tuple[Evr, ...],
    moved: tuple[Evr, ...],
) -> tuple[State, MonitorState, tuple[Evr, ...]]:
    """Monitors say what happened; the response may only reduce or stop."""
    arm = (state.mode, state.tool, state.move, sensors, state.joints, state.pressing)
    seen, found = watch(config, state.monitors, *arm, usable=not bad)
    found = bad + found
    if state.move is not None:
        found += unsafe_setpoint(config, lowest_for(config, state.move), last_rad, state.move.hold.motor_rad)
    found += moved
    if not found:
        return state, seen, ()
    before = Guarded(state.mode, state.move, state.sequence, state.fault, ())
    after = guard(config, before, last_rad, state.joints, found)
    state = replace(state, mode=after.mode, move=after.move, sequence=after.sequence, fault=after.fault)
    return state, seen, after.evrs


def _output(
    config: Config,
    before: State,
    state: State,
    seen: MonitorState,
    tool: ToolChannels | None,
    evrs: tuple[Evr, ...],
) -> tuple[State, Outputs]:
    """What leaves flight software in this cycle."""
    if state.tick == 0:
        evrs = (Booted(config.params_sha256), *evrs)
    if state.mode is not before.mode:
        evrs = (*evrs, ModeChanged(before.mode, state.mode))
    channels = joint_channels(state)
    drive = drive_for(config, state.move, state.joints, state.drive)
    after = replace(state, tick=state.tick + 1, monitors=seen, drive=drive)
    return after, Outputs(drive, channels, tool, evrs)

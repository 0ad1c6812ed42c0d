"""One control cycle: sensors, commands -> estimate -> decide -> move -> protect -> drive, telemetry, evrs."""

from dataclasses import replace

from fsw.config import Config
from fsw.dictionary.channels import ToolChannels
from fsw.dictionary.commands import Command
from fsw.dictionary.evrs import Booted, Evr, ModeChanged
from fsw.dictionary.modes import Mode
from fsw.estimate import joints as joint_estimate
from fsw.estimate import load as load_estimate
from fsw.executive.commands import Situation, handle
from fsw.messages import Outputs, Sensors
from fsw.motion.drive import drive_for
from fsw.motion.move import advance
from fsw.protect import monitors
from fsw.protect.guard import guard
from fsw.state import State, joint_channels


def step(
    config: Config, state: State, sensors: Sensors, commands: tuple[Command, ...]
) -> tuple[State, Outputs]:
    """The state and the outputs after one cycle; everything follows from the arguments."""
    before = state
    bad_readings = monitors.non_finite(sensors)
    state, tool_channels = _estimate(config, state, sensors, usable=not bad_readings)
    state, decided = _decide(config, state, commands)
    state, moved = _move(config, state, sensors, usable=not bad_readings)
    state, found = _protect(config, state, sensors, bad_readings, moved)
    return _output(config, before, state, tool_channels, decided + moved + found)


def _estimate(
    config: Config, state: State, sensors: Sensors, usable: bool
) -> tuple[State, ToolChannels | None]:
    """Joint angles every cycle, load and tool pose every so often; bad readings leave the last estimate."""
    if not usable:
        return state, None
    joints = joint_estimate.update(config, state.joints, sensors)
    if not joints.referenced or state.tick % config.params.motion.tool_channels_period != 0:
        return replace(state, joints=joints), None
    load, joints, channels = load_estimate.refresh(config, state.tick, state.tool, joints, state.load)
    return replace(state, joints=joints, load=load), channels


def _decide(config: Config, state: State, commands: tuple[Command, ...]) -> tuple[State, tuple[Evr, ...]]:
    """Commands change what the arm is about to do."""
    if not commands:
        return state, ()
    now = Situation(state.mode, state.tool, state.joints, state.planned_gap_rad, state.move)
    for command in commands:
        now = handle(config, now, command)
    state = replace(
        state, mode=now.mode, tool=now.tool, joints=now.joints, planned_gap_rad=now.gap_rad, move=now.move
    )
    return state, now.evrs


def _move(config: Config, state: State, sensors: Sensors, usable: bool) -> tuple[State, tuple[Evr, ...]]:
    """The move under way, one cycle on."""
    if state.move is None or not usable:
        return state, ()
    result = advance(config, state.move, state.joints, sensors)
    mode = state.mode if result.end_mode is None else result.end_mode
    return replace(state, move=result.move, mode=mode), result.evrs


def _protect(
    config: Config, state: State, sensors: Sensors, bad_readings: tuple[Evr, ...], moved: tuple[Evr, ...]
) -> tuple[State, tuple[Evr, ...]]:
    """Monitors say what happened; the response may only reduce or stop. A standing fault is said once."""
    seen, found = state.monitors, bad_readings
    if not bad_readings:
        seen, found = monitors.watch(config, seen, state.mode, state.move, sensors, state.joints)
    if state.mode is Mode.FAULTED:
        return replace(state, monitors=seen), ()
    if not (found or moved):
        return state if seen is state.monitors else replace(state, monitors=seen), ()
    mode, move, response = guard(state.mode, state.move, state.joints, found + moved)
    return replace(state, monitors=seen, mode=mode, move=move), found + response


def _output(
    config: Config, before: State, state: State, tool: ToolChannels | None, evrs: tuple[Evr, ...]
) -> tuple[State, Outputs]:
    """What leaves flight software in this cycle."""
    if state.tick == 0:
        evrs = (Booted(config.params_sha256), *evrs)
    if state.mode is not before.mode:
        evrs = (*evrs, ModeChanged(before.mode, state.mode))
    channels = joint_channels(state)
    drive = drive_for(config, state.move, state.joints, state.drive)
    return replace(state, tick=state.tick + 1, drive=drive), Outputs(drive, channels, tool, evrs)

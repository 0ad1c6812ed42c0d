"""One control cycle: sensors, commands -> estimate -> decide -> move -> protect -> drive, telemetry, evrs."""

from dataclasses import replace

from fsw.config import Config
from fsw.dictionary.channels import ToolChannels
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Booted, Evr, ModeChanged
from fsw.estimate import joints as joint_estimate
from fsw.estimate.hardstop import HardstopFit
from fsw.estimate.joints import JointEstimate, LoadEstimate
from fsw.executive.commands import handle, proceed
from fsw.executive.protection import MoveOutcome, apply_decision, describe_arm
from fsw.executive.situation import Situation
from fsw.kinematics.transforms import Array
from fsw.messages import Outputs, Sensors
from fsw.motion.drive import drive_for
from fsw.motion.move import Phase, advance, pressing_in
from fsw.motion.plan_press import Pressing
from fsw.protect.protection import protect
from fsw.protect.readings import check_readings
from fsw.state import State, joint_channels


def step(
    config: Config, state: State, sensors: Sensors, commands: tuple[Command, ...]
) -> tuple[State, Outputs]:
    """The state and the outputs after one cycle; everything follows from the arguments."""
    before, config = state, state.changed or config
    unusable = check_readings(config.protection, sensors)
    usable = not unusable
    joints, load, tool_channels = _estimate(config, state, sensors, usable)
    state, joints, decided = _decide(config, state, joints, load, sensors, commands, usable)
    # at rest the last set-point is where the motors are, in today's encoder zero
    last_rad = joints.motor_rad if before.move is None else before.move.hold.motor_rad
    moved, joints, pressing, planned_gap_rad = _move(config, state, joints, load, sensors, usable)
    lie = joints.backlash_state
    arm = describe_arm(moved.mode, state.tool, joints, lie[2], moved.move, pressing)
    monitors, decision = protect(
        config.protection, state.monitors, moved.fault, arm, sensors, last_rad, unusable, moved.evrs
    )
    after = moved if decision is None else apply_decision(config, moved, decision, joints)
    # built once, as a stage that changed a few fields of it would copy them all
    state = State(
        tick=before.tick + 1,
        mode=after.mode,
        tool=state.tool,
        joints=joints,
        load=load,
        planned_gap_rad=planned_gap_rad,
        move=after.move,
        pressing=pressing,
        sequence=after.sequence,
        fault=after.fault,
        monitors=monitors,
        drive=drive_for(config, after.move, joints, state.drive),
        changed=state.changed,
    )
    return state, _outputs(config, before, state, lie, tool_channels, decided + after.evrs)


def _estimate(
    config: Config, state: State, sensors: Sensors, usable: bool
) -> tuple[JointEstimate, LoadEstimate, ToolChannels | None]:
    """Joint angles every cycle, load and tool pose every so often; bad readings leave the last estimate."""
    if not usable:
        return state.joints, state.load, None
    joints = joint_estimate.update_joints(config, state.joints, sensors)
    if state.load.known and state.tick % config.params.motion.load_period != 0:
        return joints, state.load, None
    push = None if state.pressing is None else state.pressing.pushed
    load, joints, channels = joint_estimate.update_load(
        config, state.tick, state.tool, joints, state.load, push
    )
    return joints, load, channels


def _decide(
    config: Config,
    state: State,
    joints: JointEstimate,
    load: LoadEstimate,
    sensors: Sensors,
    commands: tuple[Command, ...],
    usable: bool,
) -> tuple[State, JointEstimate, tuple[Evr, ...]]:
    """Commands change what the arm is about to do, and what is known of its joints."""
    if not commands and (state.sequence is None or state.move is not None):
        return state, joints, ()
    now = Situation(replace(state, joints=joints, load=load), usable, closed=sensors.switch_closed)
    for command in commands:
        now = handle(now.state.changed or config, now, command)
    now = proceed(now.state.changed or config, now)
    return now.state, now.state.joints, now.evrs


def _move(
    config: Config, state: State, joints: JointEstimate, load: LoadEstimate, sensors: Sensors, usable: bool
) -> tuple[MoveOutcome, JointEstimate, Pressing | None, Array]:
    """The move under way, one cycle on, to be protected; with bad readings only the brakes go on."""
    mode, move, pressing, gap_rad = state.mode, state.move, state.pressing, state.planned_gap_rad
    evrs: tuple[Evr, ...] = ()
    if move is not None and (usable or move.phase is Phase.BRAKE):
        result = advance(config, move, joints, load, sensors)
        if move.press is not None:
            pressing = pressing_in(result.move or move)
        move, evrs = result.move, result.evrs
        mode = mode if result.end_mode is None else result.end_mode
        gap_rad = gap_rad if result.gap_rad is None else result.gap_rad
        if result.stop is not None:
            joints, calibrated = _calibrate(config, joints, load, *result.stop)
            evrs = (calibrated, *evrs)
    return MoveOutcome(mode, move, state.sequence, state.fault, evrs), joints, pressing, gap_rad


def _calibrate(
    config: Config, joints: JointEstimate, load: LoadEstimate, joint: Joint, found: HardstopFit
) -> tuple[JointEstimate, Evr]:
    """The joints with the zero of one that has found its hardstop."""
    calibrated = joint_estimate.apply_calibration(config, joints, load.torque_Nm, joint, found)
    return calibrated, found.to_event(joint, float((calibrated.motor_rad - joints.motor_rad)[joint]))


def _outputs(
    config: Config, before: State, state: State, lie: Array, tool: ToolChannels | None, evrs: tuple[Evr, ...]
) -> Outputs:
    """What leaves flight software in this cycle."""
    if before.tick == 0:
        evrs = (Booted(config.params_sha256), *evrs)
    if state.mode is not before.mode:
        evrs = (*evrs, ModeChanged(before.mode, state.mode))
    return Outputs(state.drive, joint_channels(before.tick, state, lie), tool, evrs)

"""The cycle of flight software, and the temperature of its arm."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from fsw.config import CYCLE_HZ, ticks
from fsw.cycle import step
from fsw.dictionary.commands import MoveJoints, Retract, SetParam, Stop, Unstow
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Booted
from fsw.kinematics.chain import forward, tool_pose
from fsw.state import boot, outputs_at_rest
from tests.fsw.rig import Rig, alive, config_of, content, facing, floats, quiet_sensors
from tests.tools import tool_index

CONFIG = config_of()
START = facing(CONFIG, "apxs")


def seal(record) -> None:
    """Make every array under a record read-only."""
    if isinstance(record, np.ndarray):
        record.flags.writeable = False
    elif is_dataclass(record):
        for field in fields(record):
            seal(getattr(record, field.name))
    elif isinstance(record, tuple):
        for item in record:
            seal(item)


def session():
    """Sensors and commands of a little of everything."""
    rig = Rig(CONFIG, start_rad=START)
    script = {
        5: (MoveJoints(floats(START + 0.01)),),
        60: (Stop(),),
        150: (rig.here("apxs", 0.005),),
        420: (rig.touch("apxs", 0.004),),
        440: (),
    }
    return rig, script


def test_same_arguments_same_outputs_bit_for_bit_and_arguments_unchanged():
    rig, script = session()
    config = rig.config
    seal(config)
    state, count = rig.state, rig.count
    for tick in range(700):
        commands = script.get(tick, (Retract("apxs", 0.003),) if tick == 650 else ())
        bad = {"current_A": [np.nan] * 5} if tick == 600 else {}
        read = count * config.rad_per_count + alive(tick)
        sensors = quiet_sensors(count, cycle=tick, resolver_rad=read, **bad)
        seal(state)
        before = content(state)
        first = step(config, state, sensors, commands)
        second = step(config, state, sensors, commands)
        assert content(first) == content(second)
        assert content(state) == before
        state, outputs = first
        drive = outputs.drive
        count = np.where(drive.power_on & drive.brake_release, drive.setpoint_count, count)


def test_the_first_cycle_says_which_parameters_it_runs_on_and_time_is_the_tick():
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    assert [rig.cycle().joint.tick for _ in range(6)] == [0, 1, 2, 3, 4, 5]
    assert rig.evrs == [Booted(CONFIG.params_sha256)]


def test_before_the_first_cycle_brakes_are_on_and_power_is_off():
    state = boot(CONFIG, Mode.STOWED)
    outputs = outputs_at_rest(state)
    for values in (outputs.drive.power_on, outputs.drive.brake_release, outputs.drive.setpoint_rate_rad_s):
        assert not values.any()
    assert outputs.evrs == ()
    assert not state.joints.initialised


def test_without_calibrated_joints_nothing_moves_but_the_tool_pose_that_resolvers_make_likely_is_told():
    rig = Rig(CONFIG, Mode.STOWED, CONFIG.params.poses.stowed_rad, calibrated=False)
    channels = []
    for _ in range(40):
        out = rig.cycle(Unstow())
        assert not out.drive.power_on.any()
        assert not out.joint.calibrated.any()
        channels += [] if out.tool is None else [out.tool.output_rad]
    np.testing.assert_allclose(
        channels[-1], CONFIG.params.poses.stowed_rad, atol=2 * CONFIG.half_backlash_rad.max()
    )


def test_the_tool_channels_come_at_their_period_and_are_where_the_settled_arm_is():
    rig = Rig(CONFIG, start_rad=START)
    rig.cycle(rig.here("apxs", 0.001))
    rig.run()
    channels = [out.tool for out in (rig.cycle() for _ in range(160)) if out.tool is not None]
    assert len(channels) == 160 // CONFIG.params.motion.load_period_cycles
    X = rig.tool_pose("apxs")
    np.testing.assert_allclose(channels[-1].p_RoTo_R_m, X.p, atol=1e-7)
    np.testing.assert_allclose(channels[-1].R_RT, X.R, atol=1e-7)
    assert channels[-1].tool == tool_index("apxs")


def test_a_duration_lasts_at_least_its_whole_cycles():
    assert ticks(0.0) == 0
    assert ticks(1.0) == CYCLE_HZ
    assert ticks(1.0 + 1e-9) == CYCLE_HZ + 1


HEAT = CONFIG.params.heat


def reads(rig: Rig, warm_C: float, cycles: int = 1) -> None:
    rig.warm_C = warm_C
    for _ in range(cycles):
        rig.cycle()


def present(rig: Rig):
    return rig.state.changed_config or rig.config


def test_the_first_reading_is_the_temperature_of_the_arm_and_a_colder_one_is_shorter():
    rig = Rig(CONFIG, start_rad=START)
    assert present(rig).structure_C == HEAT.calibration_C
    cold = Rig(CONFIG, start_rad=START, warm_C=-55.0)
    assert present(cold).structure_C == pytest.approx(-55.0, abs=1e-3)
    assert cold.outputs.tool.structure_C == present(cold).structure_C
    arm = present(cold).arm
    p_m, cold_m = (tool_pose(one, forward(one, START), "apxs").p for one in (CONFIG.arm, arm))
    assert 1e-3 < np.linalg.norm(cold_m - p_m) < 4e-3
    assert present(cold).protection.arm is arm


def test_the_arm_is_built_anew_only_after_a_step():
    rig = Rig(CONFIG, start_rad=START)
    reads(rig, HEAT.calibration_C + 0.9 * HEAT.step_K, 64 * 50)
    assert rig.state.changed_config is None
    reads(rig, HEAT.calibration_C + 1.1 * HEAT.step_K, 64 * 50)
    assert present(rig).structure_C - HEAT.calibration_C == pytest.approx(HEAT.step_K, abs=0.01)


def test_a_move_keeps_the_arm_that_it_was_planned_with():
    rig = Rig(CONFIG, start_rad=START)
    rig.until_moving(MoveJoints(floats(START + 0.05)))
    while rig.state.move is not None:
        assert present(rig).arm is CONFIG.arm
        reads(rig, 30.0)
    reads(rig, 30.0, CONFIG.params.motion.load_period_cycles)
    assert present(rig).structure_C > HEAT.calibration_C + HEAT.step_K


def test_the_first_temperature_is_the_mean_of_usable_readings_alone_and_no_other_reading_changes_it():
    rig, period = Rig(CONFIG, start_rad=START, calibrated=False), CONFIG.params.motion.load_period_cycles
    for _ in range(100 * period):
        rig.cycle(structure_C=float("nan"))
    for warm_C in (20.0, 20.8, 21.6):
        reads(rig, warm_C, period)
    before_C = rig.state.structure_C
    assert before_C == pytest.approx(20.8, abs=1e-3)
    rig.cycle()
    before_C = rig.state.structure_C
    for wrong_C in (float("nan"), 200.0):
        rig.cycle(structure_C=wrong_C)
        assert rig.state.structure_C == before_C


def test_the_compensation_can_be_turned_off_and_a_changed_parameter_keeps_the_temperature():
    rig = Rig(CONFIG, start_rad=START, warm_C=-55.0)
    rig.cycle(SetParam("motion.tool_speed_m_s", 0.04))
    assert present(rig).structure_C == pytest.approx(-55.0, abs=1e-3)
    assert not np.array_equal(present(rig).arm.RP_CF, CONFIG.arm.RP_CF)
    rig.cycle(SetParam("heat.compensated_share", 0.0))
    np.testing.assert_allclose(present(rig).arm.RP_CF, CONFIG.arm.RP_CF, atol=1e-15)

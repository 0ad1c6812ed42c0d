"""The arm of flight software grows with the temperature that it reads, between moves."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints, SetParam
from fsw.kinematics.chain import forward, tool_pose
from tests.fsw.rig import Rig, config_of, facing, floats

CONFIG = config_of()
START = facing(CONFIG, "apxs")
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
    for warm_C in (20.0, 23.0, 26.0):
        reads(rig, warm_C, period)
    before_C = rig.state.structure_C
    assert before_C == pytest.approx(23.0, abs=1e-3)
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

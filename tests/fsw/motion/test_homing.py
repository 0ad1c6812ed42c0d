"""Homing of a joint: its results at a hardstop, and its faults if the hardstop is not as expected."""

import numpy as np
import pytest

from fsw.dictionary import faults
from fsw.dictionary.commands import Calibrate, CalibrateAll, MoveJoint
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint, Mode
from fsw.dictionary.evrs import (
    CommandAborted,
    CommandAccepted,
    CommandCompleted,
    FaultResponse,
    JointCalibrated,
)
from fsw.executive.poses import HOMED_TWICE
from fsw.motion.homing import HomingStage
from helpers.marks import slow_but
from tests.fsw.motion.stops import StopRig
from tests.fsw.rig import config_of, floats, with_params

STOPS_RAD = np.array([joint.hardstop_rad for joint in config_of().params.joints.in_order()])
BEFORE_RAD = 0.1
START = STOPS_RAD + BEFORE_RAD
CONFIG = with_params(
    hardstop={"start_rad": floats(START), "park_rad": floats(START), "second_start_rad": floats(START)}
)
ZERO_ERROR_RAD = np.array([1e-3, -1.2e-3, 0.8e-3, 1.5e-3, -0.5e-3])
STOP_NM_RAD = 200e3
EACH_JOINT = slow_but(Joint, Joint.TURRET)
COMPLIANCE_RAD_NM = 1 / CONFIG.arm.gear_stiffness_Nm_rad + 1 / STOP_NM_RAD


def of(evrs, kind):
    return [evr for evr in evrs if isinstance(evr, kind)]


def faulted(rig, joint, kind):
    evrs = rig.run(Calibrate(joint), at_most=6000)
    (evr,) = of(evrs, kind)
    assert evr.joint is joint
    assert FaultResponse("BRAKE_AND_REFUSE") in evrs
    assert CommandAborted("Calibrate") in evrs
    assert not of(evrs, JointCalibrated)
    assert rig.state.mode is Mode.FAULTED
    assert not rig.outputs.joint.calibrated[joint]
    assert not rig.outputs.drive.power_on.any()
    return evr


@pytest.mark.parametrize("joint", EACH_JOINT)
@pytest.mark.parametrize("calibrated", slow_but([True, False], True))
def test_a_joint_finds_its_zero_at_its_hardstop_pressing_gently_and_moves_back_inside(joint, calibrated):
    rig = StopRig(CONFIG, START, ZERO_ERROR_RAD, calibrated=calibrated)
    evrs = rig.run(Calibrate(joint))
    (found,) = of(evrs, JointCalibrated)
    assert CommandCompleted("Calibrate") in evrs
    assert rig.state.mode is Mode.DEPLOYED
    assert rig.outputs.joint.calibrated[joint]
    assert rig.state.joints.motor_rad[joint] == pytest.approx(rig.motor_rad[joint], abs=0.1e-3)
    if calibrated:
        assert found.moved_rad == pytest.approx(-ZERO_ERROR_RAD[joint], abs=0.1e-3)
    assert found.compliance_urad_Nm == pytest.approx(1e6 * COMPLIANCE_RAD_NM[joint], rel=0.05)
    assert found.backlash_rad == pytest.approx(2 * CONFIG.half_backlash_rad[joint], abs=0.1e-3)
    press_Nm = CONFIG.params.joints.in_order()[joint].hardstop_press_Nm
    assert 0.8 * press_Nm < rig.pressed_Nm < 1.3 * press_Nm
    assert rig.state.joints.motor_rad[joint] < CONFIG.arm.soft_min_rad[joint]
    if calibrated:
        evrs = rig.run(MoveJoint(joint, float(START[joint])))
        assert CommandCompleted("MoveJoint") in evrs
        assert not of(evrs, FaultResponse)


@pytest.mark.parametrize("joint", EACH_JOINT)
def test_a_joint_that_already_stands_at_its_hardstop_finds_it_too(joint):
    rig = StopRig(CONFIG, START - (BEFORE_RAD - 1e-3) * (np.arange(5) == joint))
    assert CommandCompleted("Calibrate") in rig.run(Calibrate(joint))
    assert rig.state.joints.motor_rad[joint] == pytest.approx(rig.motor_rad[joint], abs=0.1e-3)


@pytest.mark.parametrize("joint", EACH_JOINT)
def test_a_joint_that_stalls_before_its_hardstop_says_so(joint):
    window = CONFIG.params.hardstop.window_rad
    early = faulted(StopRig(CONFIG, START, stop_off_rad=1.5 * window), joint, faults.StalledEarly)
    assert early.stop_rad == STOPS_RAD[joint]
    assert early.angle_rad == pytest.approx(STOPS_RAD[joint] + 1.5 * window, abs=3e-3)


@pytest.mark.parametrize("joint", EACH_JOINT)
def test_what_gives_way_like_no_hardstop_is_none(joint):
    gear = 1 / CONFIG.arm.gear_stiffness_Nm_rad[joint]
    too_soft = (1.5 * CONFIG.params.hardstop.stiffness_ratio * COMPLIANCE_RAD_NM[joint] - gear) * STOP_NM_RAD
    rig = StopRig(CONFIG, START, softer=too_soft)
    evr = faulted(rig, joint, faults.HardstopImplausible)
    assert evr.compliance_urad_Nm > CONFIG.params.hardstop.stiffness_ratio * evr.nominal_urad_Nm
    assert evr.nominal_urad_Nm == pytest.approx(1e6 * COMPLIANCE_RAD_NM[joint])


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "sign"), [(Joint.ELBOW, -1), (Joint.TURRET, 1)])
def test_a_hardstop_is_not_to_be_elsewhere_than_it_was_found_before(joint, sign):
    bound = CONFIG.params.hardstop.moved_rad
    for share, moved in ((0.9, False), (1.1, True)):
        off = sign * share * bound * (np.arange(5) == joint)
        rig = StopRig(CONFIG, START, off)
        if moved:
            evr = faulted(rig, joint, faults.HardstopMoved)
            assert evr.bound_rad == bound
            assert evr.moved_rad == pytest.approx(sign * share * bound, abs=0.1e-3)
        else:
            assert CommandCompleted("Calibrate") in rig.run(Calibrate(joint))
        rig = StopRig(CONFIG, START, off, calibrated=False)
        assert CommandCompleted("Calibrate") in rig.run(Calibrate(joint))


@pytest.mark.parametrize("joint", EACH_JOINT)
def test_a_motor_that_neither_turns_nor_draws_current_is_stuck(joint):
    rig = StopRig(CONFIG, START)
    rig.dead = True
    evr = faulted(rig, joint, faults.MotorStuck)
    assert abs(evr.current_A) < 0.1 < evr.limit_A


def test_a_stall_without_a_rise_of_torque_is_unclear():
    rig = StopRig(CONFIG, START)
    rig.until(Calibrate(Joint.WRIST), lambda: rig.state.move.homing.stage is HomingStage.FINE)
    rig.seized = True
    evrs = rig.run(at_most=2000)
    assert faults.HardstopUnclear(Joint.WRIST) in evrs
    assert not rig.outputs.joint.calibrated[Joint.WRIST]


def test_a_current_that_cannot_be_is_not_believed():
    rig = StopRig(CONFIG, START)
    rig.until(Calibrate(Joint.WRIST), lambda: rig.state.move.homing.stage is HomingStage.COARSE)
    (evr,) = of(rig.run(at_most=200, current_A=np.full(5, -2.9)), faults.CurrentImplausible)
    assert evr == faults.CurrentImplausible(Joint.WRIST, -2.9, evr.limit_A)
    assert evr.limit_A < 2.9


@pytest.mark.slow
def test_all_joints_are_calibrated_one_after_the_other_and_then_wait_where_they_are_parked():
    rig = StopRig(CONFIG, START, ZERO_ERROR_RAD, calibrated=False)
    evrs = rig.run(CalibrateAll(), at_most=60_000)
    assert CommandCompleted("CalibrateAll") in evrs
    assert [evr.joint for evr in of(evrs, JointCalibrated)] == [*HARDSTOP_ORDER, HOMED_TWICE]
    assert evrs.count(CommandAccepted("MoveJoint")) == len(Joint) + 1
    assert rig.outputs.joint.calibrated.all()
    assert rig.state.mode is Mode.DEPLOYED
    np.testing.assert_allclose(rig.state.joints.motor_rad, rig.motor_rad, atol=0.1e-3)
    np.testing.assert_allclose(rig.output_rad, START, atol=0.2e-3)

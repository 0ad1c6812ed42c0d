"""Homing of a joint: its results at a hardstop, and its faults if the hardstop is not as expected."""

import numpy as np
import pytest

from fsw.config import Config
from fsw.dictionary import faults
from fsw.dictionary.commands import Calibrate, CalibrateAll, Command, MoveJoint
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint, Mode
from fsw.dictionary.evrs import (
    CommandAborted,
    CommandAccepted,
    CommandCompleted,
    FaultResponse,
    JointCalibrated,
)
from fsw.executive.poses import HOMED_TWICE
from fsw.messages import Outputs
from fsw.motion.homing import HomingStage
from helpers.marks import slow_but
from tests.fsw.rig import Rig, alive, config_of, floats, with_params

FRICTION_NM = 60.0
"""Friction of motor and gear."""
NOISE_A = 0.005


class StopRig(Rig):
    """Rig with encoder zeros off by `zero_error_rad`, hardstops by `stop_off_rad`, and `softer` hardstops."""

    def __init__(
        self, config: Config, start_rad, zero_error_rad=0.0, stop_off_rad=0.0, softer=1.0, calibrated=True
    ):
        joints = config.params.joints.in_order()
        self.zero_error_rad = np.zeros(5) + zero_error_rad
        self.stop_rad = np.array([joint.hardstop_rad for joint in joints]) + stop_off_rad
        self.stop_Nm_rad = np.array([joint.hardstop_stiffness_Nm_rad for joint in joints]) / softer
        self.current_A = np.zeros(5)
        self.output_rad: np.ndarray | None = None
        self.dead = False
        self.seized = False
        self.pressed_Nm = 0.0
        self._rng = np.random.default_rng(7)
        super().__init__(config, start_rad=np.array(start_rad) + self.zero_error_rad, calibrated=calibrated)

    @property
    def motor_rad(self) -> np.ndarray:
        """Return the true motor angles."""
        return self.count * self.config.rad_per_count - self.zero_error_rad

    def resolver_rad(self) -> np.ndarray:
        if self.output_rad is None:
            return super().resolver_rad() - self.zero_error_rad
        return self.output_rad + alive(self.cycles)

    def cycle(self, *commands: Command, **readings) -> Outputs:
        before = self.count
        noise = NOISE_A * self._rng.standard_normal(5)
        out = super().cycle(*commands, **{"current_A": self.current_A + noise, **readings})
        if self.output_rad is None:
            self.output_rad = self.motor_rad
            self.output_rad = np.array([self._torque(j, before[j], 0.0)[1] for j in range(5)])
        commanded, self.count, self.current_A = self.count, before, np.zeros(5)
        for j in np.flatnonzero(out.drive.power_on & out.drive.brake_release):
            self._turn(j, commanded[j])
        return out

    def _turn(self, j: int, commanded: int) -> None:
        """Turn a motor by one cycle and set its current."""
        constant = self.config.torque_constant_Nm_A[j]
        most_Nm = 0.0 if self.dead else self.outputs.drive.current_limit_A[j] * constant
        sign = np.sign(commanded - self.count[j])
        near, far = self.count[j], commanded
        if self.seized:
            far = self.count[j]
        elif sign * self._torque(j, far, sign)[0] > most_Nm:
            while abs(far - near) > 1:
                middle = (near + far) // 2
                can_reach = sign * self._torque(j, middle, sign)[0] <= most_Nm
                near, far = (middle, far) if can_reach else (near, middle)
            far = near
        stalled = far != commanded
        torque, output = self._torque(j, far, sign)
        self.count = np.where(np.arange(5) == j, far, self.count)
        self.output_rad = np.where(np.arange(5) == j, output, self.output_rad)
        self.current_A[j] = (sign * most_Nm if stalled else torque) / constant
        self.pressed_Nm = max(self.pressed_Nm, self.stop_Nm_rad[j] * (self.stop_rad[j] - output))

    def _torque(self, j: int, count: int, sign: float) -> tuple[float, float]:
        """Compute the motor torque and the output at a count; friction holds the output within its bounds."""
        motor = count * self.config.rad_per_count[j] - self.zero_error_rad[j]
        load, friction = self.state.load.torque_Nm[j], self.config.output_friction_Nm[j]
        low, high = (self._balance(j, motor, load + side * friction) for side in (-1, 1))
        output = min(max(self.output_rad[j], low), high)
        half, stiffness = self.config.half_backlash_rad[j], self.config.arm.gear_stiffness_Nm_rad[j]
        twist = output - motor
        return sign * FRICTION_NM - stiffness * (twist - np.clip(twist, -half, half)), output

    def _balance(self, j: int, motor: float, pull_Nm: float) -> float:
        """Compute the equilibrium of an output without friction between its gear and its hardstop."""
        k, stop, stop_k = self.config.arm.gear_stiffness_Nm_rad[j], self.stop_rad[j], self.stop_Nm_rad[j]
        half = self.config.half_backlash_rad[j]
        free = motor + pull_Nm / k + (half if pull_Nm > 0 else -half)
        if free >= stop:
            return free
        lifted, pushed = (
            (pull_Nm + k * (motor + side * half) + stop_k * stop) / (k + stop_k) for side in (-1, 1)
        )
        if lifted - motor < -half:
            return lifted
        return pushed if pushed - motor > half else stop + pull_Nm / stop_k


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

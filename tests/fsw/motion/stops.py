"""Rig with hardstops: motors turn as far as their current limit allows, and outputs have backlash."""

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import Command
from fsw.messages import Outputs
from tests.fsw.rig import Rig, alive

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

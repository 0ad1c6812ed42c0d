"""Avionics between flight software and plant: motor controllers, brakes, encoders, resolvers, switches.

The position loop and the current limit of each motor controller run inside the MuJoCo step, on its dcmotor.
"""

from copy import copy, deepcopy
from dataclasses import replace
from typing import Final

import mujoco
import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from fsw.messages import ActuatorCommand, Counts, Flags, Sensors
from sim.effects.effect import (
    Effect,
    Hardware,
    apply_cycle_effects,
    apply_sensor_errors,
    draw_move_disturbance,
)
from sim.frames import FLIP
from sim.mujoco_settings import RESISTANCE
from sim.plant import Plant, as_slice

HEATING_K: Final = 0.5
"""Largest change in a cycle of the temperature around a motor: half of what a reading may change."""
UNPOWERED: Final = np.zeros(len(Joint), bool)
VIBRATION_N: Final = 10.0
VIBRATION_AXES: Final = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Force directions in turret axes, one per cycle: 16 Hz about the axis of the turret."""


class Avionics:
    """Avionics of one plant, which turn actuator commands into plant inputs and plant state into readings."""

    def __init__(self, plant: Plant, hardware: Hardware, rng: np.random.Generator):
        model = plant.model
        motors = plant.at.actuators
        switches = [model.sensor(switch).id for switch in plant.switches]
        self._plant = plant
        self._hardware = hardware
        self._rng = rng
        self._move_rng = move_rng(rng)
        self._motors = motors
        self._integral = model.actuator_actadr[motors]
        self._resistance_Ohm = model.actuator_gainprm[motors, RESISTANCE].copy()
        self._ambient_C = hardware.ambient_C
        self._winding_rise_K = np.zeros(len(motors))
        self._winding_time_s = plant.data.time
        self._touch = as_slice(model.sensor_adr[switches])
        self._closed = np.zeros(len(plant.switches), bool)
        self._brake_cycles = np.rint(hardware.brake_delay_s * CYCLE_HZ).astype(int)
        self._pending: dict[int, tuple[int, bool]] = {}
        self._drive: ActuatorCommand | None = None
        self._cycle = 0
        self._turret = model.body("turret").id
        self._shaken = False
        self._update_constants()

    def _update_constants(self) -> None:
        """Compute what depends on model and hardware only; these change only when an effect begins."""
        self._next_s = min((effect.at_s for effect in self._hardware.timed), default=np.inf)
        self._gravity_R = FLIP * self._plant.model.opt.gravity + self._hardware.gravity_bias_R_m_s2
        hardware = self._hardware
        sigma = (
            hardware.resolver_noise_rad,
            hardware.current_noise_A,
            hardware.gravity_noise_m_s2,
            hardware.structure_noise_K,
        )
        self._noise_sigma = np.repeat(sigma, (5, 5, 3, 1))
        self._winding_K_A2 = self._resistance_Ohm * hardware.winding_K_W
        self._elapsed_s, self._winding_share = 0.0, np.zeros_like(self._winding_K_A2)

    def for_plant(self, plant: Plant) -> "Avionics":
        """Copy the avionics, attached to a copy of their plant."""
        other = copy(self)
        other._plant, other._pending = plant, dict(self._pending)
        other._rng, other._move_rng = deepcopy(self._rng), deepcopy(self._move_rng)
        return other

    def inject(self, effect: Effect) -> None:
        """Add an effect to avionics and plant, which begins at once or at its time."""
        self._hardware = effect.on_hardware(self._hardware)
        self._update_constants()

    def missed_cycles(self) -> int:
        """Return and reset the number of cycles in which flight software is not called."""
        missed = self._hardware.missed_cycles
        if missed:
            self._hardware = replace(self._hardware, missed_cycles=0)
        return missed

    def _start_due_effects(self) -> None:
        """Begin all timed effects whose time has come."""
        now_s, timed = self._plant.data.time, self._hardware.timed
        self._hardware = replace(self._hardware, timed=tuple(e for e in timed if e.at_s > now_s))
        for effect in timed:
            if effect.at_s <= now_s:
                self._hardware = effect.begin(self._plant, self._hardware)
        self._update_constants()

    def sense(self) -> Sensors:
        """Read all sensors."""
        if self._plant.data.time >= self._next_s:
            self._start_due_effects()
        plant, hardware = self._plant, self._hardware
        noise = self._rng.standard_normal(14) * self._noise_sigma
        current = plant.motor_current_A()
        resolver = plant.output_rad() + hardware.resolver_bias_rad + noise[:5]
        for error in hardware.resolver_errors:
            resolver += error.error_rad(plant.output_rad())
        self._cycle += 1
        step_rad = hardware.resolver_step_rad
        sensors = Sensors(
            cycle=self._cycle,
            encoder_count=self.encoder_count(),
            resolver_rad=np.rint(resolver / step_rad) * step_rad if step_rad else resolver,
            current_A=current + noise[5:10],
            winding_C=self._update_ambient() + self._update_winding_rise(current),
            structure_C=hardware.structure_C + hardware.structure_offset_K + float(noise[13]),
            switch_closed=self._update_switches(),
            gravity_R_m_s2=self._gravity_R + noise[10:13],
        )
        if hardware.sensor_errors:
            sensors, updated = apply_sensor_errors(hardware.sensor_errors, sensors, self._rng)
            self._hardware = replace(hardware, sensor_errors=updated)
        return sensors

    @property
    def brakes_move(self) -> bool:
        """Return whether a brake was commanded and has not yet moved."""
        return bool(self._pending)

    def encoder_count(self) -> Counts:
        """Return the encoder counts, shape (5,); no state changes."""
        angle = self._plant.motor_rad() - self._zero_rad()
        return np.rint(angle / self._hardware.rad_per_count).astype(np.int64)

    def _zero_rad(self) -> Array:
        """Return the motor angles at which the counters read 0, shape (5,)."""
        zero: Array = self._hardware.counter_zero_rad + self._plant.move_disturbance.motor_rad
        return zero

    def _update_switches(self) -> Flags:
        """Update the closed flags; a snap-action switch opens at a lower force than it closes at."""
        hardware = self._hardware
        bound_N = np.where(self._closed, hardware.switch_release_N, hardware.switch_force_N)
        self._closed = self._plant.data.sensordata[self._touch] > bound_N
        return self._closed

    def _update_ambient(self) -> Array:
        """Update the temperatures around the motors [degC], shape (5,), which do not jump."""
        if self._ambient_C is not self._hardware.ambient_C:
            change_K = np.clip(self._hardware.ambient_C - self._ambient_C, -HEATING_K, HEATING_K)
            self._ambient_C = self._ambient_C + change_K if change_K.any() else self._hardware.ambient_C
        return self._ambient_C

    def _update_winding_rise(self, current_A: Array) -> Array:
        """Update the rise of the windings over ambient [K], shape (5,).

        The thermal model of MuJoCo is not used: it heats with the current before the limit and never cools.
        """
        now_s, hardware = self._plant.data.time, self._hardware
        final_K = current_A * current_A * self._winding_K_A2
        # exponential approach to the final rise; nearly all readings are a cycle apart
        if (elapsed_s := now_s - self._winding_time_s) != self._elapsed_s:
            self._elapsed_s, self._winding_share = elapsed_s, -np.expm1(-elapsed_s / hardware.winding_s)
        self._winding_time_s = now_s
        self._winding_rise_K = self._winding_rise_K + self._winding_share * (final_K - self._winding_rise_K)
        return self._winding_rise_K

    def apply(self, drive: ActuatorCommand) -> None:
        """Apply an actuator command: set-points at once, brakes after their delay."""
        data, model = self._plant.data, self._plant.model
        if data.time >= self._hardware.power_until_s:
            drive = replace(drive, power_on=UNPOWERED, brake_release=UNPOWERED, vibrate=False)
        last, self._drive = self._drive, drive
        if self._hardware.each_move and drive.power_on.any() and not (last and last.power_on.any()):
            self._begin_move()
        motor_rad = drive.setpoint_count * self._hardware.rad_per_count + self._zero_rad()
        self._plant.command(motor_rad, drive.setpoint_rate_rad_s)
        if last is None or drive.current_limit_A is not last.current_limit_A:
            limit = drive.current_limit_A * self._plant.torque_constant_Nm_A
            model.actuator_forcerange[self._motors] = np.column_stack([-limit, limit])
        if last is None or drive.power_on is not last.power_on:
            was_on = np.zeros_like(drive.power_on) if last is None else last.power_on
            data.act[self._integral[drive.power_on & ~was_on]] = 0.0
            model.opt.disableactuator = sum(2 << joint for joint in Joint if not drive.power_on[joint])
        if last is None or drive.brake_release is not last.brake_release:
            self._command_brakes(drive, last)
        if self._pending:
            self._move_brakes()
        if drive.vibrate or self._shaken:
            self._shake(drive.vibrate)
        if self._hardware.each_cycle:
            self.act()

    def act(self) -> None:
        """Apply the effects that act in every cycle."""
        self._hardware = apply_cycle_effects(self._plant, self._hardware)

    def _begin_move(self) -> None:
        """Draw the disturbance of a move; an arm in contact keeps the one before."""
        disturbance = draw_move_disturbance(self._hardware.each_move, self._move_rng)
        if not self._plant.data.ncon:
            self._plant.set_move_disturbance(disturbance)

    def _shake(self, on: bool) -> None:
        """Turn the unbalance of the vibration motor by a quarter turn; remove its force once it is off."""
        data, turret = self._plant.data, self._turret
        mujoco.mj_kinematics(self._plant.model, data)  # a step leaves the axes of its start
        R_WB = data.xmat[turret].reshape(3, 3)
        data.xfrc_applied[turret, :3] = VIBRATION_N * on * (R_WB @ VIBRATION_AXES[self._cycle % 4])
        self._shaken = on

    def _command_brakes(self, drive: ActuatorCommand, last: ActuatorCommand | None) -> None:
        for joint in Joint:
            on = not drive.brake_release[joint]
            if on != (last is None or not last.brake_release[joint]):
                self._pending[joint] = (int(self._brake_cycles[joint]), on)

    def _move_brakes(self) -> None:
        waiting = {}
        for joint, (cycles, on) in self._pending.items():
            if cycles == 0:
                if on or not self._hardware.brake_stuck[joint]:
                    self._plant.brake(joint, on)
            else:
                waiting[joint] = (cycles - 1, on)
        self._pending = waiting


def move_rng(rng: np.random.Generator) -> np.random.Generator:
    """Make the generator of the move disturbances, which draws nothing from that of the sensor noise."""
    return rng.spawn(1)[0]

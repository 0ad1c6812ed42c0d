"""Truth of a servo that swings a weight: its equation of motion, integrated without a physics engine.

    (m l^2 + armature) a = torque - back-EMF v - viscous v - m g l sin q - friction

The back-EMF acts only under power. Dry friction takes at most the speed that a step would have without it, so
that it holds exactly. The nominal model knows neither back-EMF nor armature, and has friction and gain of
another servo. The numbers are of the order of those of an XL330 (models/robots/pendulum/PROVENANCE.md).
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.robot import Robot
from validation.cases.robot_truth import Nuisances, Run, TrueEffect

BACK_EMF_Nms_rad: Final = 0.048
VISCOUS_Nms_rad: Final = 0.006
"""Friction of the bearings, which acts without power too."""
ARMATURE_kgm2: Final = 0.0017
FACTORS: Final = {"damping": (0.6, 1.6), "friction": (0.5, 2.0), "armature": (0.5, 1.6), "gain": (0.6, 1.4)}
"""Ranges of the true numbers over those above, of friction and gain over those of the model."""
GAINS: Final = (200.0, 300.0, 400.0, 600.0, 800.0, 1200.0)
GAIN_OF_MOTION: Final = (0, 1, 2, 3, 4, 5, 2, 2, 3, 0, 5, 4)
OFF_FROM_S: Final = {3: 3.0, 10: 3.0}
"""Motion -> time from which the servo has no power."""
SETTLE_S: Final = 1.0
GRAVITY_m_s2: Final = 9.81
SPIKE_RAD: Final = -math.pi
"""What the log has in place of a position that was not read."""
SPIKE_SHARE: Final = 0.12
"""Share of motions with such a sample: 7 of 60 logs of a real servo."""


def motion_gains(n_motions: int, times_s: Array) -> Array:
    """Return the gain at each sample, (n_motions, n); 0 where the servo has no power."""
    gains = np.array([GAINS[GAIN_OF_MOTION[k]] for k in range(n_motions)])
    off_s = np.array([OFF_FROM_S.get(k, math.inf) for k in range(n_motions)])
    return np.where(times_s < off_s[:, None], gains[:, None], 0.0)


class ServoPlant:
    """A true servo with its weight, and effects."""

    def __init__(
        self,
        robot: Robot,
        nuisances: Nuisances,
        effects: Sequence[TrueEffect],
        step_s: float,
        added_kg: float = 0.0,
    ) -> None:
        """Set the numbers of the servo, with a mass that is added at the weight."""
        self.robot, self.effects, self.step_s = robot, tuple(effects), step_s
        body, (joint,) = robot.model.body("arm"), robot.joints
        mass, self.length_m = float(body.mass[0]), -float(body.ipos[2])
        self.link_kgm2 = (mass + added_kg) * self.length_m**2 + float(body.inertia[1])
        self.weight_Nm = (mass + added_kg) * GRAVITY_m_s2 * self.length_m
        self.armature_kgm2 = ARMATURE_kgm2 * float(nuisances.armature[0])
        self.back_emf = BACK_EMF_Nms_rad * float(nuisances.damping[0])
        self.viscous = VISCOUS_Nms_rad * float(nuisances.damping[0])
        self.dry_Nm = float(robot.model.dof_frictionloss[0] * nuisances.friction[0])
        self.kp, self.limit_Nm = joint.kp_Nm_rad * float(nuisances.gain[0]), joint.torque_limit_Nm

    def simulate(
        self, commands: Array, period_s: float, seed: int, temperature_degC: tuple[float, float], gain: Array
    ) -> Array:
        """Return what the encoder shows, as `Plant.simulate` does; a gain, (n,), is 0 without power."""
        h, n = self.step_s, commands.shape[1]
        steps = round((n - 1) * period_s / h)
        time_s = h * np.arange(-round(SETTLE_S / h), steps + 1)
        sample = np.clip((time_s / period_s + 1e-9).astype(int), 0, n - 1)
        delay_s = math.fsum(effect.command_delay_s for effect in self.effects)
        late_s = math.fsum(effect.log_delay_s for effect in self.effects)
        share = np.clip(time_s / ((n - 1) * period_s), 0.0, 1.0)
        heat_degC = temperature_degC[0] + share * (temperature_degC[1] - temperature_degC[0])
        inputs = zip(
            time_s.tolist(), _hold(commands[0], period_s, time_s - delay_s, h).tolist(),
            (self.kp * gain[sample]).tolist(), heat_degC.tolist(), strict=True,
        )  # fmt: skip
        q, start = float(commands[0, 0]), [0.0]
        run = Run(h, np.random.default_rng(seed), q=[q], v=start[:], shown=[q], command=[q])
        run.motor_Nm, run.load_Nm = [0.0], [0.0]
        for effect in self.effects:
            effect.begin(run)
        seen = np.array([self._step(run, *one) for one in inputs])
        if not np.isfinite(seen).all() or np.abs(seen).max() > 1e3:
            raise FloatingPointError("the truth diverged")
        return np.asarray(np.interp(period_s * np.arange(n) - late_s, time_s, seen))[None]

    def _step(self, run: Run, time_s: float, command: float, kp: float, heat_degC: float) -> float:
        """Advance by a step, and return what the encoder showed before it."""
        effects, h, q, v = self.effects, self.step_s, run.q[0], run.v[0]
        run.time_s, run.temperature_degC = time_s, heat_degC
        shown, torque, friction_Nm = q, 0.0, self.dry_Nm
        for one in effects:
            shown = one.shows(run, shown)
        for one in effects:
            command = one.command(run, command)
        error = command - shown
        for one in effects:
            error = one.error(run, error)
        if kp > 0.0:
            torque = kp * error
            for one in effects:
                torque = one.servo(run, torque)
            torque = min(max(torque, -self.limit_Nm), self.limit_Nm)
            for one in effects:
                torque = one.limited(run, torque, self.limit_Nm)
        run.shown[0], run.command[0], run.motor_Nm[0] = shown, command, torque
        for one in effects:
            torque += one.torque_Nm(run)
            friction_Nm += one.friction_Nm(run)
        damping = self.viscous + (self.back_emf if kp > 0.0 else 0.0)
        inertia = self.link_kgm2 + self.armature_kgm2
        weight_Nm = self.weight_Nm * math.sin(q)
        free = (v + h * (torque - weight_Nm) / inertia) / (1.0 + h * damping / inertia)
        speed = math.copysign(max(abs(free) - h * max(friction_Nm, 0.0) / inertia, 0.0), free)
        run.load_Nm[0] = weight_Nm + self.link_kgm2 * (speed - v) / h
        run.v[0], run.q[0] = speed, q + h * speed  # symplectic: no energy comes or goes
        return shown


def _hold(command: Array, period_s: float, begin_s: Array, step_s: float) -> Array:
    """Return the mean over steps of a command that is held between its samples, (n_steps,)."""
    edges_s = period_s * np.arange(-1, command.size + 1)
    edges_s[0], edges_s[-1] = begin_s[0], max(begin_s[-1] + step_s, edges_s[-1])
    held = np.concatenate([command[:1], command])
    area = np.concatenate([[0.0], np.cumsum(held * np.diff(edges_s))])
    means = np.diff(np.interp([*begin_s, begin_s[-1] + step_s], edges_s, area)) / step_s
    return np.asarray(means)

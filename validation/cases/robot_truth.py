"""Simulator of the truth: plain MuJoCo with small steps, and effects that are written a second time.

It shares no code with the diagnosis. The servo law, all effects and the dry friction are evaluated in every
physics step. The integrator is `implicit`, the step an eighth of that of the robot's model. Commands are held
between their samples. Encoders sit at the joint, behind backlash and compliance of its gear. Dry friction,
damping and armature sit at the motor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

import mujoco
import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Family
from simgap.robot import Robot

TRUE_STEP_S: Final = 0.00025
"""Step of the truth: a quarter of it moves the samples by less than a tenth of the noise (see the tests)."""
SETTLE_S: Final = 1.0
"""Time at the first command before a log begins: some ten time constants of the slowest servo."""
GEAR: Final = "_gear"
"""Suffix of the second hinge of a joint: between its motor and its link."""
HARD: Final = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance of dry friction; the default of MuJoCo creeps under load."""


@dataclass(slots=True)
class Run:
    """State of one motion, which effects read: plain numbers, a list entry a joint."""

    step_s: float
    rng: np.random.Generator
    time_s: float = 0.0
    q: list[float] = field(default_factory=list)
    v: list[float] = field(default_factory=list)
    shown: list[float] = field(default_factory=list)
    command: list[float] = field(default_factory=list)
    motor_Nm: list[float] = field(default_factory=list)
    load_Nm: list[float] = field(default_factory=list)
    """Torque that the gear carries: of gravity and of the inertia behind the motor."""
    temperature_degC: float = 25.0
    """Temperature of all motors at this time."""
    model: mujoco.MjModel = None
    data: mujoco.MjData = None


@dataclass(frozen=True, slots=True)
class Scene:
    """Nominal robot, and the motions that it is asked for: all that an effect may know."""

    robot: Robot
    low_rad: tuple[float, ...]
    """Least command of each joint."""
    high_rad: tuple[float, ...]
    lowest_m: float
    """Least height that the tool reaches without an effect."""


class TrueEffect:
    """Effect of the truth at a place. The size is positive or has a sign; 0 is absent."""

    name: ClassVar[str]
    family: ClassVar[Family]
    families: ClassVar[frozenset[Family]]
    """Families that name its mechanism rightly."""
    needs_load: ClassVar[bool]
    """True if it reads the load of the gears, which costs time."""
    is_everywhere: ClassVar[bool]
    """True if it acts on the servos of all joints."""

    def __init_subclass__(
        cls,
        *,
        name: str,
        family: Family,
        also: tuple[Family, ...] = (),
        needs_load: bool = False,
        is_everywhere: bool = False,
    ) -> None:
        cls.name, cls.family, cls.families = name, family, frozenset({family, *also})
        cls.needs_load, cls.is_everywhere = needs_load, is_everywhere

    def __init__(self, scene: Scene, place: str, size: float, shape: float = 0.5) -> None:
        """Make it at a joint or body, of a size in its unit and a shape, a number from 0 to 1."""
        self.scene, self.robot, self.place, self.size, self.shape = scene, scene.robot, place, size, shape
        names = [joint.name for joint in scene.robot.joints]
        self.j = names.index(place) if place in names else 0
        self.acts_on = self.j

    def build(self, spec: mujoco.MjSpec) -> None:
        """Change the model before it is compiled."""

    def begin(self, run: Run) -> None:
        """Set the state of the effect at the beginning of a motion."""

    @property
    def command_delay_s(self) -> float:
        """Time that the command of this joint is late."""
        return 0.0

    @property
    def log_delay_s(self) -> float:
        """Time that the logged position of this joint is old."""
        return 0.0

    def command(self, run: Run, command: float) -> float:
        """Return the command of this joint as the servo sees it."""
        return command

    def error(self, run: Run, error: float) -> float:
        """Return the position error of this joint as the servo sees it."""
        return error

    def servo(self, run: Run, torque_Nm: float) -> float:
        """Return the torque of the motor before its limit."""
        return torque_Nm

    def limited(self, run: Run, torque_Nm: float, limit_Nm: float) -> float:
        """Return the torque of the motor after its limit."""
        return torque_Nm

    def friction_Nm(self, run: Run) -> float:
        """Return the dry friction to add at this joint."""
        return 0.0

    def torque_Nm(self, run: Run) -> float:
        """Return the external torque at the joint `acts_on`."""
        return 0.0

    def act(self, run: Run) -> None:
        """Change the model or the data before a physics step."""

    def shows(self, run: Run, q_rad: float) -> float:
        """Return what the encoder of this joint shows."""
        return q_rad


Hook = Any


@dataclass(frozen=True, slots=True)
class Nuisances:
    """Factors on the nominal numbers of each joint, (n_joints,)."""

    damping: Array
    friction: Array
    armature: Array
    gain: Array


class Plant:
    """A true robot: the nominal one with nuisances and effects."""

    def __init__(
        self, robot: Robot, nuisances: Nuisances, effects: Sequence[TrueEffect], step_s: float = TRUE_STEP_S
    ) -> None:
        self.robot, self.effects, self.step_s = robot, tuple(effects), step_s
        spec = mujoco.MjSpec.from_string(robot.model_xml)
        for effect in effects:
            effect.build(spec)
        spec.option.timestep = step_s
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
        self.model = spec.compile()
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
        names = [joint.name for joint in robot.joints]
        ids = [mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in names]
        self.dof = [int(self.model.jnt_dofadr[one]) for one in ids]
        self.qpos = [int(self.model.jnt_qposadr[one]) for one in ids]
        self.gear = [self._gear(name) for name in names]
        self.gain = [float(one) for one in nuisances.gain]
        self.model.dof_damping[self.dof] *= nuisances.damping
        self.model.dof_frictionloss[self.dof] *= nuisances.friction
        self.model.dof_armature[self.dof] *= nuisances.armature
        self.model.dof_solimp[:] = HARD
        self.model.dof_solref[:] = (4.0 * step_s, 1.0)
        self.dry_Nm = self.model.dof_frictionloss.copy()
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def _gear(self, joint: str) -> tuple[int, int] | None:
        """Return the addresses of a joint's second hinge in qpos and qvel; None if it has none."""
        one = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, joint + GEAR)
        return None if one < 0 else (int(self.model.jnt_qposadr[one]), int(self.model.jnt_dofadr[one]))

    def simulate(
        self,
        commands: Array,
        period_s: float,
        seed: int,
        temperature_degC: tuple[float, float] = (25.0, 25.0),
    ) -> Array:
        """Return what the encoders show at the times of the commands, without noise, (n_joints, n) [rad].

        Commands, (n_joints, n) [rad], are held until the next sample; temperatures are those of the first and
        the last. FloatingPointError if the simulation diverged.
        """
        return _Motion(self, commands, period_s, seed, temperature_degC).simulate()


class _Motion:
    """One motion of a plant."""

    def __init__(
        self, plant: Plant, commands: Array, period_s: float, seed: int, temperature: tuple[float, float]
    ) -> None:
        self.plant, self.period_s = plant, period_s
        self.data = data = mujoco.MjData(plant.model)
        self.q, self.v, self.applied_Nm = data.qpos, data.qvel, data.qfrc_applied
        self.n = commands.shape[1]
        self.run = Run(plant.step_s, np.random.default_rng(seed), model=plant.model, data=data)
        joints = plant.robot.joints
        law = [
            (joint.kp_Nm_rad * gain, joint.kd_Nms_rad * gain, joint.torque_limit_Nm)
            for joint, gain in zip(joints, plant.gain, strict=True)
        ]
        hooks = [self._collect(name) for name in ("shows", "command", "error", "servo", "limited")]
        self.joints = list(zip(range(len(joints)), law, *hooks, strict=True))
        before, steps = (round(time_s / plant.step_s) for time_s in (SETTLE_S, (self.n - 1) * period_s))
        self.times_s = np.arange(-before, steps + 1) * plant.step_s
        share = np.clip(self.times_s / ((self.n - 1) * period_s), 0.0, 1.0)
        self.heat_degC = temperature[0] + share * (temperature[1] - temperature[0])
        late_s = [self._total("command_delay_s", j) for j in range(len(commands))]
        self.held = np.array([self._hold(row, late_s[j]) for j, row in enumerate(commands)])
        self.late = [self._total("log_delay_s", j) for j in range(len(joints))]
        self.first = commands[:, 0].tolist()
        self.frictions = self._list("friction_Nm")
        self.torques = self._list("torque_Nm")
        self.gears = [(j, *gear) for j, gear in enumerate(plant.gear) if gear is not None]
        self.acts = self._list("act")
        self.knows_load = any(effect.needs_load for effect in plant.effects)

    def _total(self, name: str, j: int) -> float:
        return math.fsum(getattr(effect, name) for effect in self.plant.effects if effect.j == j)

    def _list(self, name: str) -> list[tuple[int, Hook]]:
        """Return the hooks that are not those of the base class."""
        return [
            (effect.acts_on, getattr(effect, name))
            for effect in self.plant.effects
            if getattr(type(effect), name) is not getattr(TrueEffect, name)
        ]

    def _collect(self, name: str) -> list[list[Hook]]:
        found: list[list[Hook]] = [[] for _ in self.plant.robot.joints]
        for j, hook in self._list(name):
            rows = found if hook.__self__.is_everywhere else found[j : j + 1]
            for row in rows:
                row.append(hook)
        return found

    def _hold(self, row: Array, delay_s: float) -> Array:
        """Return the mean of the held command over each step: a delay need not be a number of steps."""
        step_s = self.plant.step_s
        end = (self.times_s + step_s - delay_s) / self.period_s
        k = np.clip(np.floor(end).astype(int), 0, self.n - 1)
        share = (end - k) * self.period_s / step_s
        held = np.where((share >= 1.0) | (k == 0), row[k], share * row[k] + (1.0 - share) * row[k - 1])
        return np.asarray(held)

    def simulate(self) -> Array:
        run, plant, data, first = self.run, self.plant, self.data, self.first
        data.qpos[plant.qpos] = first
        mujoco.mj_forward(plant.model, data)
        run.q, run.v, run.shown = first[:], [0.0] * len(first), first[:]
        run.command, run.motor_Nm, run.load_Nm = first[:], [0.0] * len(first), [0.0] * len(first)
        for effect in plant.effects:
            effect.begin(run)
        inputs = zip(self.times_s.tolist(), self.heat_degC.tolist(), self.held.T.tolist(), strict=True)
        seen = np.array([self._step(*one) for one in inputs])
        if not np.isfinite(seen).all() or np.abs(seen).max() > 1e3 or data.warning.number.any():
            raise FloatingPointError("the truth diverged")
        wanted = np.arange(self.n) * self.period_s
        rows = [np.interp(wanted - late, self.times_s, seen[:, j]) for j, late in enumerate(self.late)]
        return np.asarray(rows)

    def _step(self, time_s: float, heat_degC: float, held: list[float]) -> list[float]:
        """Advance by a physics step, and return what the encoders showed before it."""
        run, plant, data = self.run, self.plant, self.data
        run.time_s, run.temperature_degC = time_s, heat_degC
        q, v = self.q.tolist(), self.v.tolist()
        run.q = [q[k] for k in plant.qpos]
        run.v = [v[k] for k in plant.dof]
        for j, position, speed in self.gears:
            run.q[j] += q[position]
            run.v[j] += v[speed]
        if self.knows_load:
            self._update_load()
        self._control(held)
        external = [0.0] * len(held)
        for j, hook in self.torques:
            external[j] += hook(run)
        for dof, motor_Nm, other_Nm in zip(plant.dof, run.motor_Nm, external, strict=True):
            self.applied_Nm[dof] = motor_Nm + other_Nm
        for j, _, speed in self.gears:
            self.applied_Nm[speed] = external[j]
        if self.frictions:
            dry = plant.dry_Nm.copy()
            for j, hook in self.frictions:
                dry[plant.dof[j]] += hook(run)
            plant.model.dof_frictionloss[:] = np.maximum(dry, 0.0)
        for _, hook in self.acts:
            hook(run)
        mujoco.mj_step(plant.model, data)
        return run.shown[:]

    def _control(self, held: list[float]) -> None:
        """Read the encoders, and compute the torques of the motors."""
        run = self.run
        for j, (kp, kd, limit), shows, commands, errors, servos, limits in self.joints:
            shown, rate, command = run.q[j], run.v[j], held[j]
            for hook in shows:
                shown = hook(run, shown)
            if shows:  # a servo knows its speed from its encoder
                rate = (shown - run.shown[j]) / run.step_s if self.data.time > 0.0 else 0.0
            run.shown[j] = shown
            for hook in commands:
                command = hook(run, command)
            run.command[j] = command
            error = command - shown
            for hook in errors:
                error = hook(run, error)
            torque = kp * error - kd * rate
            for hook in servos:
                torque = hook(run, torque)
            torque = min(max(torque, -limit), limit)
            for hook in limits:
                torque = hook(run, torque, limit)
            run.motor_Nm[j] = torque

    def _update_load(self) -> None:
        data, dof = self.data, self.plant.dof
        carried = data.qfrc_applied + data.qfrc_constraint + data.qfrc_passive
        own = self.plant.model.dof_armature * data.qacc
        self.run.load_Nm = (carried - own)[dof].tolist()

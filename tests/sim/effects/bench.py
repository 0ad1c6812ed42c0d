"""Test bench for one joint: the arm with effects, and one joint turned at a set speed."""

from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np

from fsw.dictionary.enums import Joint
from sim.avionics import Avionics
from sim.effects.effect import Effect, Hardware, apply_cycle_effects, apply_effects, nominal_hardware
from sim.plant import ALL_ACTUATORS, Plant
from sim.setting import World
from sim.world import build
from tests.sim import lab

Array = lab.Array
SPEED_RAD_S = np.array([1.0, 1.0, 1.0, 2.0, 2.0]) * np.pi / 180
TORQUE_CONSTANT_NM_A = np.array([228.6, 228.6, 228.6, 86.33, 86.33])


@cache
def _nominal(world: World) -> mujoco.MjSpec:
    return build(world)


def build_arm(
    *effects: Effect, world: World | None = None, calm: bool = False, steps_per_cycle: int | None = None
) -> tuple[Plant, Hardware]:
    """Build the arm with these effects, without rover and ground; `calm` settles soon, see tests.sim.lab."""
    spec = _nominal(world or World()).copy()
    if steps_per_cycle is not None:
        spec.option.timestep = 1.0 / (steps_per_cycle * lab.CYCLE_HZ)
    if world is None or world.surface is None:
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
    if calm:
        lab.settle_fast(spec)
    hardware = apply_effects(effects, spec, nominal_hardware())
    return Plant(spec.compile()), hardware


def avionics(plant: Plant, hardware: Hardware) -> Avionics:
    """Make avionics without sensor noise."""
    quiet = {"resolver_noise_rad": 0.0, "current_noise_A": 0.0, "gravity_noise_m_s2": 0.0}
    return Avionics(plant, replace(hardware, **quiet), np.random.default_rng(1))


def set_angles(plant: Plant, motor_rad: Array) -> Plant:
    """Set the motors to these angles, undeflected and at rest."""
    mujoco.mj_resetData(plant.model, plant.data)
    plant.data.qpos[plant.at.motor] = motor_rad
    mujoco.mj_forward(plant.model, plant.data)
    return plant


@dataclass(frozen=True)
class TurnRecord:
    """Record of a joint that was turned; one row a control cycle."""

    current_A: Array
    """Current at the end of each cycle, as sensors read it."""
    mean_A: Array
    """Mean current of each cycle: a set-point that is held for a cycle lets the current fall within it."""
    motor_rad: Array
    output_rad: Array

    def steady_A(self) -> float:
        """Return the mean current of the last second, over whole cycles: speed ripples within a cycle."""
        return float(self.mean_A[-64:].mean())


def turn_joint(
    joint: Joint,
    *effects: Effect,
    seconds: float = 2.5,
    speed: float = 1.0,
    every: int | None = None,
    steps_per_cycle: int | None = None,
    start_rad: Array = lab.READY_RAD,
    back: bool = False,
    world: World | None = None,
) -> TurnRecord:
    """Bring one joint to a share of its speed within a second, and hold it; with `back`, turn it back too.

    The effects are evaluated once every `every` steps of physics, or once a cycle.
    """
    plant, hardware = build_arm(*effects, world=world, steps_per_cycle=steps_per_cycle)
    state, in_cycle = [hardware], plant.steps_per_cycle

    def act() -> None:
        if state[0].each_cycle:
            state[0] = apply_cycle_effects(plant, state[0])

    plant.place(start_rad, 4.0, act)
    plant.model.opt.disableactuator = ALL_ACTUATORS & ~(2 << joint)
    plant.brake(joint, False)
    rows, currents, rate = [], [], 0.0
    angle, rates = np.array(start_rad, float), np.zeros(len(Joint))
    full, dt = speed * SPEED_RAD_S[joint], plant.model.opt.timestep
    for goal in [full, -full] if back else [full]:
        first = rate
        for step in range(round(seconds / dt)):
            rate = first + (goal - first) * lab.smooth_step(min(step * dt, 1.0))
            if step % in_cycle == 0:
                rates[joint] = rate
                plant.damp_gears()
                plant.command(angle, rates)
            if step % (every or in_cycle) == 0:
                act()
            mujoco.mj_step(plant.model, plant.data)
            plant.update_motors()
            currents.append(plant.motor_current_A()[joint])
            angle[joint] += rate * dt
            if step % in_cycle == in_cycle - 1:
                angles = plant.motor_rad()[joint], plant.output_rad()[joint]
                rows.append((currents[-1], np.mean(currents[-in_cycle:]), *angles))
    return TurnRecord(*np.array(rows).T)

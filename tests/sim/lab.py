"""Test bench for the arm: a plant of any world, brought to rest with care."""

from collections.abc import Callable
from copy import copy
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Joint
from sim.initialisation import true_reference as true_reference
from sim.loop import ClosedLoop
from sim.plant import JOINT_NAMES, Plant
from sim.setting import World
from sim.world import build

Array = NDArray[np.float64]
Edit = Callable[[mujoco.MjSpec], None]

READY_RAD = np.radians([0.0, -60.0, 110.0, 130.0, 90.0])
STOWED_RAD = np.radians([89.86, -15.91, -161.89, 178.57, 34.01])
LEFT_RAD = np.radians([-35.0, -70.0, 95.0, 20.0, 215.0])
STRAIGHT_RAD = np.zeros(5)

STIFFNESS_NM_RAD = np.array([100e3, 100e3, 100e3, 50e3, 50e3])
HALF_BACKLASH_RAD = np.array([1.82e-3, 1.82e-3, 1.82e-3, 2.18e-3, 2.18e-3])
OUTPUT_FRICTION_NM = np.array([10.0, 10.0, 10.0, 3.0, 3.0])

CYCLE_HZ = 64


def plant(world: World | None = None, time_step_s: float | None = None, edit: Edit | None = None) -> Plant:
    """Build the nominal arm in a world, at the model's time step; `edit` changes its specification first."""
    if edit is None:
        return Plant(copy(_unedited(world or World(), time_step_s)))
    spec = _spec(world or World(), time_step_s)
    edit(spec)
    return Plant(spec.compile())


def _spec(world: World, time_step_s: float | None) -> mujoco.MjSpec:
    spec = build(world)
    if time_step_s is not None:
        spec.option.timestep = time_step_s
    return spec


@cache
def _unedited(world: World, time_step_s: float | None) -> mujoco.MjModel:
    return _spec(world, time_step_s).compile()


def weightless() -> Plant:
    """Return the nominal arm in the ready pose without gravity, on its brakes."""
    placed = plant()
    placed.model.opt.gravity[:] = 0.0
    placed.place(READY_RAD, 0.0)
    return placed


def tilted_world(roll_deg: float = 0.0, pitch_deg: float = 0.0, scene: str = "mars") -> World:
    """Return a world with a tilted rover."""
    return World(scene, float(np.radians(roll_deg)), float(np.radians(pitch_deg)))


def without_output_friction(spec: mujoco.MjSpec) -> None:
    """Remove the friction of the outputs."""
    for name in JOINT_NAMES:
        spec.tendon(f"{name}_output").frictionloss = 0.0


def settle_fast(spec: mujoco.MjSpec) -> None:
    """Remove output friction and multiply link damping by twenty, so that statics need no wait."""
    without_output_friction(spec)
    for joint in spec.joints:
        if not joint.name.endswith("_motor"):
            joint.damping = 20.0 * joint.damping


def smooth_step(amount: float) -> float:
    """Return a smooth step from 0 to 1, with zero rates at both ends."""
    return amount * amount * (3 - 2 * amount)


def run(plant: Plant, duration_s: float, each_cycle: Callable[[float], None] | None = None) -> None:
    """Step the plant; `each_cycle` gets the elapsed share of the time, from 0 to 1."""
    cycles = round(duration_s * CYCLE_HZ)
    for k in range(cycles):
        if each_cycle is not None:
            each_cycle((k + 1) / cycles)
        plant.step()


def load(
    plant: Plant,
    motor_rad: Array,
    duration_s: float = 8.0,
    overload: float = 1.0,
    rest_s: float = 5.0,
    gear_rad: Array | None = None,
) -> Plant:
    """Put the arm on its brakes, apply gravity gently, with an overload if wanted, and let it settle.

    A dropped arm rests anywhere in the band in which friction can hold it. An arm under slowly growing load
    rests at the edge of that band, which is a pose that can be compared. The gears begin in the middle of
    their backlash, or at `gear_rad`.
    """
    full = plant.model.opt.gravity.copy()
    plant.model.opt.gravity[:] = 0.0
    plant.place(motor_rad, 0.0)
    if gear_rad is not None:
        plant.data.qpos[plant.at.gear] = gear_rad

    def up(amount: float) -> None:
        plant.model.opt.gravity[:] = full * overload * smooth_step(amount)

    def back(amount: float) -> None:
        plant.model.opt.gravity[:] = full * (overload + (1 - overload) * smooth_step(amount))

    run(plant, duration_s, up)
    if overload != 1.0:
        run(plant, duration_s, back)
    run(plant, rest_s)
    return plant


def hold_by_motors(plant: Plant) -> None:
    """Apply power and release the brakes: each motor controller holds the present angle of its motor."""
    plant.model.opt.disableactuator = 0
    for joint in Joint:
        plant.brake(joint, False)


def gear_rad(plant: Plant) -> Array:
    """Return output less motor angles: backlash and wind-up."""
    return plant.output_rad() - plant.motor_rad()


def gear_torque_Nm(plant: Plant) -> Array:
    """Return the gear torques, from wind-up and the nominal stiffness and backlash."""
    gear = gear_rad(plant)
    return STIFFNESS_NM_RAD * (gear - np.clip(gear, -HALF_BACKLASH_RAD, HALF_BACKLASH_RAD))


def tool_distance_mm(a: Plant, b: Plant) -> float:
    """Return the largest distance between the same tools of two arms."""
    apart = a.truth().p_RoTo_R_m - b.truth().p_RoTo_R_m
    return 1e3 * float(np.linalg.norm(apart, axis=1).max())


def run_to_rest(loop: ClosedLoop, cycles: int = 20 * CYCLE_HZ) -> list:
    """Run until the arm is at rest, and a little longer; return the events."""
    evrs = []
    for _ in range(cycles):
        record = loop.cycle()
        evrs += record.outputs.evrs
        if not record.outputs.joint.busy:
            break
    else:
        raise AssertionError("still busy")
    for _ in range(CYCLE_HZ):
        evrs += loop.cycle().outputs.evrs
    return evrs


def is_at_rest(loop: ClosedLoop) -> bool:
    """Return whether the arm is at rest on its brakes without power."""
    plant = loop.plant
    on = plant.data.eq_active[plant.at.brake].all()
    still = np.abs(plant.data.qvel[plant.at.motor]).max() < 1e-5
    return bool(on and still and not plant.data.actuator_force.any())

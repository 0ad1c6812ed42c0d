"""How fast the closed loop runs against the bare physics of the same model, in one process run."""

import time
from collections.abc import Callable
from functools import cache
from statistics import median
from typing import Any

import mujoco
import numpy as np

import sim.loop
from fsw.cycle import step
from fsw.dictionary.joints import Joint, Tool
from fsw.estimate.reference import Reference
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementRun
from sim.world import Surface, World

REPEATS = 5
BARE_STEPS = 40_000
TARGET = Placement(Tool.APXS, (2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))


@cache
def reference() -> Reference:
    return initial_reference(arm_named("nominal"))


def closed_loop_of_a_placement(with_truth: bool = False) -> ClosedLoop:
    """The arm at the ready pose in front of the target."""
    arm = arm_named("nominal")
    world = World(surface=Surface(TARGET.target_N_m, TARGET.normal_N))
    return ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, reference=reference()), with_truth)


def bare_step_s() -> float:
    """Seconds a bare mj_step: the arm held by its motors at the ready pose, brakes off."""
    plant = closed_loop_of_a_placement().plant
    plant.model.opt.disableactuator = 0
    for joint in Joint:
        plant.brake(joint, False)
    mujoco.mj_step(plant.model, plant.data, 512)
    began = time.perf_counter()
    mujoco.mj_step(plant.model, plant.data, BARE_STEPS)
    return (time.perf_counter() - began) / BARE_STEPS


def _closed_loop_step_s() -> tuple[float, float]:
    """Seconds a plant step in the closed loop of a placement, and the real-time factor."""
    loop = closed_loop_of_a_placement()
    began = time.perf_counter()
    cycles = sum(1 for _ in PlacementRun(loop, TARGET))
    wall_s = time.perf_counter() - began
    steps = cycles * loop.plant.steps_per_cycle
    return wall_s / steps, steps * loop.plant.model.opt.timestep / wall_s


def timed(function: Callable[..., Any], times_s: list[float]) -> Callable[..., Any]:
    def run(*args: Any) -> Any:
        began = time.perf_counter()
        result = function(*args)
        times_s.append(time.perf_counter() - began)
        return result

    return run


def _shares_us() -> dict[str, list[float]]:
    """Microseconds of every cycle of a placement, by part."""
    parts: dict[str, list[float]] = {"fsw_step": [], "sense": [], "apply": [], "plant_step": []}
    loop = closed_loop_of_a_placement()
    loop.avionics.sense = timed(loop.avionics.sense, parts["sense"])  # type: ignore[method-assign]
    loop.avionics.apply = timed(loop.avionics.apply, parts["apply"])  # type: ignore[method-assign]
    loop.plant.step = timed(loop.plant.step, parts["plant_step"])  # type: ignore[method-assign]
    sim.loop.step = timed(step, parts["fsw_step"])
    try:
        for _ in PlacementRun(loop, TARGET):
            pass
    finally:
        sim.loop.step = step
    return {name: [1e6 * t for t in times_s] for name, times_s in parts.items()}


def closed_loop() -> dict[str, Any]:
    """Rates and times; each ratio is the median of pairs measured one after the other."""
    pairs = [(bare_step_s(), *_closed_loop_step_s()) for _ in range(REPEATS)]
    shares = _shares_us()
    fsw = np.array(shares["fsw_step"])
    means = {name: float(np.mean(times)) for name, times in shares.items()}
    return {
        "bare_mj_steps_per_s": median(1 / bare for bare, _, _ in pairs),
        "closed_loop_steps_per_s": median(1 / closed for _, closed, _ in pairs),
        "ratio": median(bare / closed for bare, closed, _ in pairs),
        "realtime_factor": median(factor for _, _, factor in pairs),
        "fsw_step_us": {
            "median": float(np.median(fsw)),
            "p99": float(np.percentile(fsw, 99)),
            "max": float(fsw.max()),
        },
        "mean_us_per_cycle": means,
        "left_to_gain": _left_to_gain(means),
    }


def _left_to_gain(means_us: dict[str, float]) -> str:
    ours_us = means_us["fsw_step"] + means_us["sense"] + means_us["apply"]
    return (
        f"flight software and avionics take {ours_us:.0f} us of a cycle, physics "
        f"{means_us['plant_step']:.0f} us; stepping the plant in a thread while flight software works on the "
        "last readings would hide the former, at the price of one cycle of delay"
    )

"""Speed of the closed loop, as a ratio to a bare step of the model of commit 50fd31b, in one process.

`plant-50fd31b.mjb` is that model as MuJoCo compiled it, without textures. It is a fixed reference, so that
ratios of different days are comparable even if the plant becomes faster.

Example: python -m validation.closed_loop
"""

import json
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import mujoco
import numpy as np

import sim.loop
from fsw.config import CYCLE_HZ
from fsw.cycle import step
from fsw.estimate.reference import Reference
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementRun
from sim.plant import JOINT_NAMES
from sim.world import Surface, World

REPEATS = 5
BARE_STEPS = 40_000
SETTLING_STEPS = 4_096
REFERENCE_MODEL = Path(__file__).with_name("plant-50fd31b.mjb")
TARGET = Placement("apxs", (2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))


@cache
def nominal_reference() -> Reference:
    """Return the reference of the nominal arm after its hardstop initialisation."""
    return initial_reference(arm_named("nominal"))


def placement_loop(with_truth: bool = False) -> ClosedLoop:
    """Make a closed loop with the nominal arm in the ready pose in front of the target."""
    arm = arm_named("nominal")
    world = World(surface=Surface(TARGET.target_N_m, TARGET.normal_N))
    return ClosedLoop(
        Setup(arm, world, arm.params.poses.ready_rad, reference=nominal_reference()), with_truth
    )


@cache
def _reference_model() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Load the reference model at rest in the ready pose, held by its motors, brakes released."""
    model = mujoco.MjModel.from_binary_path(str(REFERENCE_MODEL))
    data = mujoco.MjData(model)
    ready = arm_named("nominal").params.poses.ready_rad
    data.qpos[[model.joint(f"{name}_motor").qposadr[0] for name in JOINT_NAMES]] = ready
    data.ctrl[0::2] = ready
    mujoco.mj_step(model, data, SETTLING_STEPS)
    return model, data


def bare_step_s() -> float:
    """Measure the seconds of a bare mj_step of the reference model, to which every speed is a ratio."""
    model, data = _reference_model()
    began = time.perf_counter()
    mujoco.mj_step(model, data, BARE_STEPS)
    return (time.perf_counter() - began) / BARE_STEPS


def _realtime_factor() -> float:
    """Measure simulated time over wall time of a placement in the closed loop."""
    loop = placement_loop()
    began = time.perf_counter()
    cycles = sum(1 for _ in PlacementRun(loop, TARGET))
    return cycles / CYCLE_HZ / (time.perf_counter() - began)


def time_calls(
    function: Callable[..., Any], times_s: list[float], clock: Callable[[], float] = time.perf_counter
) -> Callable[..., Any]:
    """Wrap a function so that the duration of each call, by a clock, is appended to `times_s`."""

    def run(*args: Any) -> Any:
        began = clock()
        result = function(*args)
        times_s.append(clock() - began)
        return result

    return run


def _part_times_us() -> dict[str, list[float]]:
    """Measure the microseconds of each part of every cycle of a placement."""
    parts: dict[str, list[float]] = {"fsw_step": [], "sense": [], "apply": [], "plant_step": []}
    loop = placement_loop()
    loop.avionics.sense = time_calls(loop.avionics.sense, parts["sense"])  # type: ignore[method-assign]
    loop.avionics.apply = time_calls(loop.avionics.apply, parts["apply"])  # type: ignore[method-assign]
    loop.plant.step = time_calls(loop.plant.step, parts["plant_step"])  # type: ignore[method-assign]
    sim.loop.step = time_calls(step, parts["fsw_step"])  # type: ignore[attr-defined]
    try:
        for _ in PlacementRun(loop, TARGET):
            pass
    finally:
        sim.loop.step = step  # type: ignore[attr-defined]
    return {name: [1e6 * t for t in times_s] for name, times_s in parts.items()}


def closed_loop() -> dict[str, Any]:
    """Measure the speed of the closed loop; each ratio is the median of alternating pairs."""
    pairs = [(bare_step_s(), _realtime_factor()) for _ in range(REPEATS)]
    bare_us = 1e6 * median(bare for bare, _ in pairs)
    step_s = _reference_model()[0].opt.timestep
    times_us = _part_times_us()
    fsw = np.array(times_us["fsw_step"])
    means = {name: float(np.mean(times)) for name, times in times_us.items()}
    ours_us = means["fsw_step"] + means["sense"] + means["apply"]
    return {
        "bare_step_us": bare_us,
        "ratio": median(factor * bare / step_s for bare, factor in pairs),
        "realtime_factor": median(factor for _, factor in pairs),
        "bare_steps": {
            "fsw_step_median": float(np.median(fsw)) / bare_us,
            "software_and_avionics_mean": ours_us / bare_us,
            "plant_step_mean": means["plant_step"] / bare_us,
        },
        "fsw_step_us": {
            "median": float(np.median(fsw)),
            "p99": float(np.percentile(fsw, 99)),
            "max": float(fsw.max()),
        },
        "mean_us_per_cycle": means,
    }


if __name__ == "__main__":
    print(json.dumps(closed_loop(), indent=2))

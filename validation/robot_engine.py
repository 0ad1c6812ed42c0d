"""Measure the forward simulation of the diagnosis against bare MuJoCo, and print one JSON document.

Steps in a second with Stribeck friction at every joint, which acts in every control period, are divided by
those of `mujoco.rollout` with the same model, starts, commands and threads. Both are measured alternately;
the median of the ratios counts. On a loaded machine the ratio is too low: the engine waits for all threads
after every control period, rollouts wait at their end alone. The engine switches the profiler of MuJoCo off;
bare rollouts keep it, as the Python package installs it.
"""

import json
import os
import sys
import time
from statistics import median
from typing import Any, Final

import mujoco
import mujoco.rollout
import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, joint_scales
from simgap.effects.forces import StribeckFriction
from simgap.logs import JointLog, Motion, Signal
from simgap.robot import Robot
from simgap.simulation.compiled import Models, control_laws, nominal_gains
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import cut_windows

ROBOT: Final = "models/robots/so101/robot.toml"
SECONDS: Final = 10.0
"""As long as the logs of the KR300; those of the XL330 last 6 s, those of the SO-101 a minute or two."""
MOTIONS: Final = 8
CANDIDATES: Final = (5, 20)
"""Candidates in 8 motions: 40 simulations, the fewest for which the bar holds, and 160."""
REPEATS: Final = 5
LEAST_RATIO: Final = 0.6


def main() -> None:
    """Measure and print; exit with 1 if a ratio is below its bound."""
    threads = os.cpu_count() or 1
    results = [engine_speed(count, n) for n in sorted({1, threads}) for count in CANDIDATES]
    print(json.dumps({"robot_engine": results}, indent=2))
    if not all(result["in_bounds"] for result in results):
        sys.exit("out of bounds: robot_engine")


def engine_speed(candidates: int, threads: int) -> dict[str, Any]:
    """Measure both with this number of candidates and threads."""
    robot = Robot.from_toml(ROBOT)
    motions = [_motion(robot, seed) for seed in range(MOTIONS)]
    windows = [window for motion in motions for window in cut_windows(robot, motion, None, 0.02)]
    models, scales = Models(robot), joint_scales(robot, motions)
    names = [joint.name for joint in robot.joints]
    effects: list[Effect] = [StribeckFriction.at(robot, name, scales) for name in names]
    typical = np.array([size.typical for effect in effects for size in effect.sizes])
    sizes = np.linspace(0.5, 1.5, candidates)[:, None] * typical
    engine = Engine(models, effects, windows, threads)
    model = _bare_model(models)
    starts = np.repeat([window.q_rad for window in windows], candidates, axis=0)
    commands = np.repeat([window.command[window.n_lead :] for window in windows], candidates, axis=0)
    n_steps = commands.shape[0] * commands.shape[1]
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        engine.positions(sizes)
        middle = time.perf_counter()
        _rollout(model, starts, commands, threads)
        times.append((middle - began, time.perf_counter() - middle))
    ratio = median(bare / ours for ours, bare in times)
    return {
        "simulations": commands.shape[0],
        "steps_each": commands.shape[1],
        "effects_in_each_period": len(effects),
        "threads": threads,
        "steps_per_s": n_steps / median(ours for ours, _ in times),
        "bare_steps_per_s": n_steps / median(bare for _, bare in times),
        "ratio": ratio,
        "least_ratio": LEAST_RATIO,
        "in_bounds": ratio >= LEAST_RATIO,
    }


def _motion(robot: Robot, seed: int) -> Motion:
    """Make sines at all joints, which begin at rest."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, SECONDS, 0.02)
    joints = {}
    for joint in robot.joints:
        value = 0.5 * (1.0 - np.cos(random.uniform(1.0, 6.0) * time_s))
        joints[joint.name] = JointLog(Signal(time_s, value), Signal(time_s, value))
    return Motion(f"sines {seed}", joints, {})


def _bare_model(models: Models) -> mujoco.MjModel:
    """Return the model with its nominal gains, which the engine otherwise sets for each simulation."""
    compiled = models.compiled([])
    model = compiled.robot.model
    kp, kd = nominal_gains(models.robot)
    gain, bias = control_laws(models.robot, kp[None], kd[None])
    limit = np.array([joint.torque_limit_Nm for joint in models.robot.joints])
    model.actuator_gainprm[compiled.actuator, 0] = gain[0]
    model.actuator_biasprm[compiled.actuator, :3] = bias[0]
    model.actuator_forcerange[compiled.actuator] = np.stack([-limit, limit], axis=1)
    return model


def _rollout(model: mujoco.MjModel, starts: Array, commands: Array, threads: int) -> None:
    """Simulate the same motions without effects."""
    states = np.zeros((starts.shape[0], mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    states[:, 1 : 1 + model.nq] = starts
    data = [mujoco.MjData(model) for _ in range(threads)]
    with mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0) as pool:
        pool.rollout([model] * starts.shape[0], data, states, commands)


if __name__ == "__main__":
    main()

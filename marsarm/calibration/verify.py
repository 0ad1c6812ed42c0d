"""Verification of a calibrated arm in the closed loop.

The arm finds its hardstops again and moves the full turret to fresh targets on Earth, Mars and cold Mars.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import MoveTool
from fsw.dictionary.params import Params
from fsw.dictionary.types import vector3
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.transforms import Array, Pose, angle_between, screw_exp
from marsarm.calibration.arm_parameters import FIXTURE_M, FIXTURE_RAD
from marsarm.calibration.campaign import CampaignFailed, earth_reference
from marsarm.calibration.simulation import true_params
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.effects.environment import Ambient
from sim.frames import approach_from, p_R_from_N, random_targets
from sim.loop import Setup
from sim.pose_sequence import free_air_loop, run_and_rest
from sim.world import World
from simgap.common.progress import Progress, part_of

COLD_C: Final = -35.0
"""Temperature of actuators and arm on cold Mars, the coldest in flight."""
MOST_TRIES: Final = 20


def register_tools(arm: BuiltArm, seed: int) -> dict[str, Pose]:
    """Simulate the measurement of every tool frame by targets on the tool and on the interface.

    Args:
        arm: Arm with its effects.
        seed: Seed of the noise.

    Returns:
        X_FT, the tool frame in frame Arm6, for every tool.
    """
    rng = np.random.default_rng([seed, 3])
    truth = build_arm(true_params(arm))
    noise = np.repeat([FIXTURE_RAD, FIXTURE_M], 3)
    return {
        tool: truth.X_FT[tool] @ screw_exp(noise * rng.standard_normal(6)) for tool in arm.params.tool_names
    }


WORLDS: Final = 3
"""Environments of a verification: Earth, Mars and cold Mars."""
HARDSTOP_TARGETS: Final = 10
"""Number of targets that last as long as the hardstops of all joints, for the progress."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaceErrors:
    """Tool errors at the targets of one environment; arrays of shape (n,)."""

    name: str
    tool: tuple[str, ...]
    total_m: Array
    lateral_m: Array
    normal_m: Array
    axis_rad: Array


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """Result of a verification."""

    zero_rad: Array
    """Encoder zeros with the new parameters less those with the old parameters, shape (5,)."""
    expected_rad: Array
    """Change of the hardstop angles, shape (5,)."""
    places: tuple[PlaceErrors, ...]


def verify_calibration(
    arm: BuiltArm, params: Params, targets: int, seed: int, progress: Progress
) -> Verification:
    """Move to fresh targets on Earth, on Mars, and on cold Mars with a shrunken arm.

    Args:
        arm: Arm with its effects.
        params: Calibrated parameters.
        targets: Number of targets in each environment.
        seed: Seed of the targets.
        progress: Callback for progress.

    Returns:
        Tool errors and changes of encoder zeros.

    Raises:
        CampaignFailed: A hardstop was not found, or a move failed.
    """
    known = replace(arm, params=params)
    stops = 2 * HARDSTOP_TARGETS
    share = stops / (stops + WORLDS * targets)
    before = earth_reference(arm, part_of(progress, 0.0, 0.5 * share))
    reference = earth_reference(known, part_of(progress, 0.5 * share, share))
    moving = part_of(progress, share, 1.0)
    changed_rad = configure(params).hardstop_rad - configure(arm.params).hardstop_rad
    cold = (Ambient(COLD_C),)
    where = (("earth", World("earth"), ()), ("mars", World(), ()), ("cold mars", World(), cold))
    places = []
    for k, (name, world, effects) in enumerate(where):
        run = VerificationRun(known, reference, world, effects, seed)
        found = []
        for one in run.tool_errors(targets):
            found.append(one)
            moving(k * targets + len(found), len(where) * targets, name)
        tools, errors = zip(*found, strict=True)
        places.append(PlaceErrors(name, tools, *np.array(errors).T))
    return Verification(reference.zero_rad - before.zero_rad, changed_rad, tuple(places))


class VerificationRun:
    """Closed loop in one environment, which moves the full turret from target to target."""

    def __init__(
        self, arm: BuiltArm, reference: Reference, world: World, effects: tuple[Effect, ...], seed: int
    ):
        ready = arm.params.poses.ready_rad
        self._loop = free_air_loop(Setup(arm, world, ready, seed, reference, effects))
        self._rng = np.random.default_rng([seed, 4])
        self._workspace = arm.model.workspace

    def tool_errors(self, targets: int) -> Iterator[tuple[str, Array]]:
        """Move to targets and measure the tool errors.

        Args:
            targets: Number of targets.

        Yields:
            The tool and its errors: total, lateral, along the approach [m], and axis [rad]; shape (4,).
        """
        for k in range(targets):
            tool = self._loop.plant.tools[k % len(self._loop.plant.tools)]
            yield tool, self._visit_target(tool)

    def _visit_target(self, tool: str) -> Array:
        for _ in range(MOST_TRIES):
            p_N_m, angles = random_targets(self._rng, 1, self._workspace)
            target, approach = p_R_from_N(p_N_m[:, 0]), approach_from(angles)[:, 0]
            problem = run_and_rest(self._loop, MoveTool(tool, vector3(target), vector3(approach)))
            if problem is None:
                return self._tool_error(tool, target, approach)
        raise CampaignFailed(f"no target in {MOST_TRIES} could be reached: {problem}")

    def _tool_error(self, tool: str, target: Array, approach: Array) -> Array:
        truth = self._loop.plant.truth()
        index = self._loop.plant.tools.index(tool)
        miss, axis = truth.p_RoTo_R_m[index] - target, truth.R_RT[index][:, 0]
        along = float(miss @ approach)
        lateral = float(np.linalg.norm(miss - along * approach))
        turned = angle_between(axis, approach)
        return np.array([np.linalg.norm(miss), lateral, along, turned])

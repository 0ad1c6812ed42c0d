"""Open-loop simulation of a recording: sensor readings and turret poses under the recorded drive."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Pose
from fsw.messages import Sensors
from marsarm.diagnosis.arm.features import SensorColumns
from marsarm.diagnosis.arm.logs import Recording
from sim.arms import effects_of_run
from sim.effects.effect import Effect
from sim.effects.environment import Ambient, StructureTemperature
from sim.loop import NOISE_FREE, OpenLoopArm, SimulationOptions
from sim.tracker import turret_pose

SENSOR_FIELDS: Final = tuple(Sensors.__dataclass_fields__)


@dataclass(frozen=True, slots=True, eq=False)
class OpenLoopRun:
    """Result of an open-loop simulation."""

    readings: tuple[Sensors, ...]
    X_RF: Mapping[int, Pose]
    """Pose of the turret interface in RMECH after the given numbers of cycles."""


def simulate_open_loop(
    recording: Recording,
    effects: Sequence[Effect],
    options: SimulationOptions = NOISE_FREE,
    pose_ticks: frozenset[int] = frozenset(),
    ticks: int | None = None,
) -> OpenLoopRun:
    """Simulate an arm with these effects under the recorded drive.

    Args:
        recording: Recorded session.
        effects: Effects that are switched on.
        pose_ticks: Numbers of cycles after which the turret pose is taken.
        ticks: Number of ticks from the start that are simulated; None for all.

    Raises:
        PlantDiverged: MuJoCo counted a warning.
    """
    arm = OpenLoopArm(recording.start, order_effects(recording, effects), options)
    readings: list[Sensors] = []
    poses: dict[int, Pose] = {}
    for reading in arm.readings(recording.drives[:ticks]):
        if len(readings) in pose_ticks:
            poses[len(readings)] = _turret(arm)
        readings.append(reading)
    return OpenLoopRun(tuple(readings), poses)


@lru_cache(maxsize=64)
def simulate_open_loop_cached(
    recording: Recording,
    effects: tuple[Effect, ...],
    options: SimulationOptions,
    ticks: int,
) -> OpenLoopRun:
    """Simulate as `simulate_open_loop`, and cache runs that several effects share."""
    return simulate_open_loop(recording, effects, options, ticks=ticks)


def order_effects(recording: Recording, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Order effects: built-in ones, temperatures, those of the run; cold changes the first ones' friction."""
    built = (effect for effect in effects if effect.built_in)
    temperatures = (Ambient(recording.temperature_C), StructureTemperature(recording.structure_C))
    return (*built, *temperatures, *effects_of_run(effects))


def stack_readings(readings: Sequence[Sensors]) -> SensorColumns:
    """Stack readings by field, ticks first."""
    return {name: np.array([getattr(one, name) for one in readings]) for name in SENSOR_FIELDS}


def _turret(arm: OpenLoopArm) -> Pose:
    arm.plant.truth()  # updates the kinematics
    return turret_pose(arm.plant)

"""The plant stepped under a recorded drive: what its sensors read, and where the turret was."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Pose
from fsw.messages import Sensors
from ground.diagnosis.arm.features import Columns
from ground.diagnosis.arm.logs import Recording
from sim.arms import effects_of_run
from sim.effects.effect import Effect
from sim.effects.environment import Ambient
from sim.open_loop import NOISE_FREE, OpenLoopArm, SimulationOptions
from sim.tracker import turret_pose

FIELDS: Final = tuple(Sensors.__dataclass_fields__)


@dataclass(frozen=True, slots=True, eq=False)
class Stepped:
    """What a stepped plant shows of one recording."""

    readings: tuple[Sensors, ...]
    X_RF: Mapping[int, Pose]
    """The turret's interface in RMECH after some numbers of cycles."""


def stepped(
    recording: Recording,
    effects: Sequence[Effect],
    manner: SimulationOptions = NOISE_FREE,
    looked: frozenset[int] = frozenset(),
) -> Stepped:
    """An arm with these effects, looked at after so many cycles.

    Raises:
        PlantDiverged: MuJoCo counted a warning.
    """
    arm = OpenLoopArm(recording.start, in_order(recording, effects), manner)
    readings: list[Sensors] = []
    poses: dict[int, Pose] = {}
    for reading in arm.readings(recording.drives):
        if len(readings) in looked:
            poses[len(readings)] = _turret(arm)
        readings.append(reading)
    if len(readings) in looked:
        poses[len(readings)] = _turret(arm)
    return Stepped(tuple(readings), poses)


@lru_cache(maxsize=64)
def stepped_once(
    recording: Recording,
    effects: tuple[Effect, ...],
    manner: SimulationOptions,
    looked: frozenset[int] = frozenset(),
) -> Stepped:
    """The same, kept for who asks again: about effects on readings alone, or about an arm without any."""
    return stepped(recording, effects, manner, looked)


def in_order(recording: Recording, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """What the arm is made of, what is around it, and what came later: the cold changes friction there is."""
    built = (effect for effect in effects if effect.built_in)
    return (*built, Ambient(recording.temperature_C), *effects_of_run(effects))


def columns(readings: Sequence[Sensors]) -> Columns:
    """Readings by field, ticks first."""
    return {name: np.array([getattr(one, name) for one in readings]) for name in FIELDS}


def _turret(arm: OpenLoopArm) -> Pose:
    arm.plant.truth()  # brings the kinematics up to date
    return turret_pose(arm.plant)

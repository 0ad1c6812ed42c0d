"""Hardstops found again and again, each time on another day."""

import numpy as np

from fsw.dictionary.enums import Joint
from sim.arms import BuiltArm
from sim.effects.environment import Ambient, CurrentNoise
from sim.effects.joints import GearFriction
from sim.initialisation import InitialisationRun, stop_run
from sim.world import World

TEMPERATURE_C = (-55.0, 10.0)
FRICTION = 0.1
"""One sigma of what friction changes from day to day, log-normal."""
NOISE_A = (0.01, 0.04)
AWAY_RAD = 0.05
BEFORE_STOP_RAD = (0.02, 0.15)


def varied(arm: BuiltArm, joint: Joint, world: World, seed: int) -> InitialisationRun:
    """One joint about to look for its hardstop: temperature, friction, noise and pose are of that day."""
    rng = np.random.default_rng([seed, joint, 5])
    friction = tuple(GearFriction(j, float(np.exp(FRICTION * rng.standard_normal()))) for j in Joint)
    effects = (Ambient(rng.uniform(*TEMPERATURE_C)), CurrentNoise(rng.uniform(*NOISE_A)), *friction)
    return stop_run(
        arm,
        joint,
        world,
        seed,
        effects,
        away_rad=rng.uniform(-AWAY_RAD, AWAY_RAD, len(Joint)),
        before_stop_rad=rng.uniform(*BEFORE_STOP_RAD),
    )

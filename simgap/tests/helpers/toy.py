"""A residual model without physics: two joints, each moved by known functions of a random command."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect, Family, Size


@dataclass(frozen=True)
class Toy(Effect):
    """Effect that adds a function of the command to the position."""

    name: ClassVar[str] = "toy"
    family: ClassVar[Family] = Family.EXTERNAL
    place: str
    label: str
    shape: Callable[[Array], Array]
    prior_std: float = np.inf
    low: float = -5.0

    @property
    def key(self):
        return f"{self.place}: {self.label}"

    @property
    def sizes(self):
        return (Size(self.label, self.low, 5.0, 1.0, self.prior_std),)


@dataclass(frozen=True)
class SharedToy(Toy):
    """Effect that adds the same function at both joints, and may replace findings of its label."""

    @property
    def parts(self):
        return tuple(Toy(name, self.label, self.shape) for name in NAMES)


class ToyResiduals:
    """Measured minus predicted values of the toys."""

    kind, method, by_motion, step_s = "simulation", "", False, 0.002
    noise_std = 0.0

    def __init__(self, commands, measured, names):
        self.commands, self.measured, self.joints = commands, measured, names
        self.units = ("rad",) * len(names)
        self.motions = tuple(f"m{k}" for k in range(commands.shape[1]))
        self.repeat_of = (*("",) * (commands.shape[1] - 2), "repeat", "repeat")
        grid = np.indices(commands.shape).reshape(3, -1)
        self.joint_of: Integers = grid[0]
        self.motion_of: Integers = grid[1]
        self.time_s: Array = grid[2].astype(float)
        self.calls = 0

    def residuals(self, effects, sizes):
        self.calls += len(sizes)
        rows = []
        for size in sizes:
            predicted = np.zeros(self.commands.shape)
            for effect, one in zip(effects, size, strict=True):
                assert isinstance(effect, Toy)
                j = self.joints.index(effect.place) if effect.place in self.joints else slice(None)
                predicted[j] += one * effect.shape(self.commands[j])
            rows.append((self.measured - predicted).ravel())
        return np.array(rows)

    def select(self, motions):
        chosen, kept = copy(self), [self.motions.index(name) for name in motions]
        ToyResiduals.__init__(chosen, self.commands[:, kept], self.measured[:, kept], self.joints)
        chosen.motions = tuple(motions)
        chosen.repeat_of = tuple(self.repeat_of[k] for k in kept)
        return chosen

    def explain(self, name):
        return self.commands.ravel()


NAMES = ("near", "far")
SHAPES: dict[str, Callable[[Array], Array]] = {
    "square": np.square,
    "cube": lambda x: x**3,
    "sine": lambda x: np.sin(9.0 * x),
    "step": np.sign,
    "double": lambda x: np.cos(7.0 * x),
}
BASE = tuple(Toy(name, "gain", lambda x: x, 3.0) for name in NAMES)
CATALOGUE = tuple(Toy(name, label, shape) for name in NAMES for label, shape in SHAPES.items())


def draw_toy(seed, truth, n_motions=10, n_samples=200):
    """Draw commands and measurements of a robot with these effects, with autocorrelated noise."""
    rng = np.random.default_rng(seed)
    commands = rng.uniform(-1.0, 1.0, (len(NAMES), n_motions, n_samples))
    commands[:, -1] = commands[:, -2]
    noise = rng.normal(0.0, 0.02, commands.shape)
    for k in range(1, n_samples):
        noise[..., k] += 0.6 * noise[..., k - 1]
    measured = noise + 0.3 * commands
    for effect in CATALOGUE:
        j = NAMES.index(effect.place)
        measured[j] += truth.get(effect.key, 0.0) * effect.shape(commands[j])
    return ToyResiduals(commands, measured, NAMES)

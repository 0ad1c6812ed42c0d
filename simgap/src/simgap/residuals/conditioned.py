"""Residuals under several conditions, whose numbers sizes follow, and about effects that are known."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect, Size
from simgap.effects.variation import Dependent, Variation
from simgap.logs import Motion
from simgap.residuals.residuals import (
    ResidualModel,
    WrappedResiduals,
    add_sizes,
    refer_to,
    residuals_by_motion,
    split_sizes,
)
from simgap.robot import Robot

MakePart = Callable[[Robot, Sequence[Motion], float], ResidualModel]
"""Makes the residuals of motions that have one robot, which are a share of all motions."""


def join_conditions(robot: Robot, motions: Sequence[Motion], make: MakePart) -> ResidualModel:
    """Make the residuals of motions, each by the robot under its conditions; RobotError if it has no such."""
    tables = {} if robot.file is None else robot.file.conditions
    parts = [make(one, part, len(part) / len(motions)) for one, part in group_by_robot(robot, motions)]
    model = parts[0] if len(parts) == 1 else JoinedResiduals(parts, [motion.name for motion in motions])
    numbers = {
        name: np.array([motion.conditions[name] - table.neutral for motion in motions])
        for name, table in tables.items()
        if table.effects
    }
    return ConditionedResiduals(model, numbers) if numbers else model


def group_by_robot(robot: Robot, motions: Sequence[Motion]) -> list[tuple[Robot, list[Motion]]]:
    """Return the robot under each set of conditions, with its motions; RobotError if it has no such."""
    setting = [name for name, one in (robot.file.conditions if robot.file else {}).items() if one.sets]
    groups: dict[tuple[float, ...], list[Motion]] = {}
    for motion in motions:
        groups.setdefault(tuple(motion.conditions[name] for name in setting), []).append(motion)
    return [(robot.under(dict(zip(setting, values, strict=True))), part) for values, part in groups.items()]


class JoinedResiduals:
    """Residuals of several models, one after the other; see `ResidualModel`."""

    by_motion = True

    def __init__(self, parts: Sequence[ResidualModel], motions: Sequence[str]) -> None:
        """Join models of different motions, which get the order of these names."""
        first = parts[0]
        self.parts, self.kind, self.units, self.joints = tuple(parts), first.kind, first.units, first.joints
        self.step_s, self.method, self.noise_std = first.step_s, first.method, first.noise_std
        self.motions = tuple(motions)
        repeats = dict(pair for one in parts for pair in zip(one.motions, one.repeat_of, strict=True))
        self.repeat_of = tuple(repeats[name] for name in motions)
        self._own = [np.array([self.motions.index(name) for name in one.motions]) for one in parts]
        self.joint_of: Integers = np.concatenate([one.joint_of for one in parts])
        self.motion_of: Integers = np.concatenate(
            [own[one.motion_of] for own, one in zip(self._own, parts, strict=True)]
        )
        self.time_s: Array = np.concatenate([one.time_s for one in parts])

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n)."""
        found = [
            residuals_by_motion(one, effects, sizes[:, own] if sizes.ndim == 3 else sizes)
            for own, one in zip(self._own, self.parts, strict=True)
        ]
        return np.concatenate(found, axis=1)

    def select(self, motions: Sequence[str]) -> ResidualModel:
        """Return the residuals of these motions alone."""
        names = set(motions)
        parts = [
            one.select([name for name in one.motions if name in names])
            for one in self.parts
            if names & {*one.motions}
        ]
        return JoinedResiduals(parts, [name for name in self.motions if name in names])

    def around(self, effects: Sequence[Effect], sizes: Array) -> ResidualModel:
        """Return the residuals with another reference."""
        return JoinedResiduals([refer_to(one, effects, sizes[0]) for one in self.parts], self.motions)

    def explain(self, name: str) -> Array:
        """Return a variable at the measured motion, (n,)."""
        return np.concatenate([one.explain(name) for one in self.parts])


class ConditionedResiduals(WrappedResiduals):
    """Residuals in which sizes follow numbers of the motions; see `ResidualModel`."""

    def __init__(self, raw: ResidualModel, numbers: Mapping[str, Array]) -> None:
        """Keep the residuals, and numbers by name with a value for each motion, (n_motions,)."""
        super().__init__(raw)
        self.by_motion = True
        self.numbers = dict(numbers)

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n); a sum of sizes ends at its bounds."""
        if sizes.ndim == 2 and not any(isinstance(one, Variation) for one in effects):
            return self.raw.residuals(effects, sizes)
        if sizes.ndim == 2:
            sizes = np.repeat(sizes[:, None], len(self.motions), axis=1)
        terms = [
            (one.effect, own * self._factors(one)) if isinstance(one, Variation) else (one, own)
            for one, own in split_sizes(effects, sizes)
        ]
        return residuals_by_motion(self.raw, *add_sizes(terms, sizes.shape[:-1]))

    def _factors(self, one: Variation) -> Array:
        """Return what sizes are multiplied by in each motion, (n_motions, n_sizes), without a unit."""
        factors = np.ones((len(self.motions), len(one.sizes)))
        factors[:, : one.n_scaled] = self.numbers[one.number][:, None]
        return factors

    def select(self, motions: Sequence[str]) -> "ConditionedResiduals":
        """Return the residuals of these motions alone."""
        kept = np.isin(self.motions, [*motions])
        numbers = {name: value[kept] for name, value in self.numbers.items()}
        return ConditionedResiduals(self.raw.select(motions), numbers)

    def around(self, effects: Sequence[Effect], sizes: Array) -> ResidualModel:
        """Return the residuals with another reference; effects that follow a number are left out of it."""
        steady = [not isinstance(one, Variation) for one in effects]
        kept = np.repeat(steady, [len(one.sizes) for one in effects])
        own = [one for one, is_steady in zip(effects, steady, strict=True) if is_steady]
        return ConditionedResiduals(refer_to(self.raw, own, sizes[0, kept]), self.numbers)


@dataclass(frozen=True)
class Change(Dependent):
    """Change of the sizes of another effect from those that are known."""

    known: tuple[float, ...]
    """Known sizes, from which bounds follow."""

    @property
    def name(self) -> str:
        """Name of the effect that changes."""
        return f"change of {self.effect_name}"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Return differences of sizes, which may have either sign."""
        return tuple(
            replace(one, low=one.low - at, high=one.high - at, prior_std=math.inf)
            for one, at in zip(self.effect.sizes, self.known, strict=True)
        )

    def describe(self, size: Array) -> str:
        """Return the changes with their signs, and what they start from."""
        parts = zip(self.effect.sizes, size, self.known, strict=True)
        return ", ".join(f"{one.name} {value:+.4g} from {at:.4g}" for one, value, at in parts)


def changes_of(known: Mapping[Effect, Array]) -> list[Change]:
    """Return the changes that known effects may have from their sizes, (n_sizes,) each."""
    return [Change(one.place, one, tuple(size.tolist())) for one, size in known.items()]


class KnownResiduals(WrappedResiduals):
    """Residuals about a model with known effects, from whose sizes all others count; see `ResidualModel`."""

    def __init__(self, raw: ResidualModel, known: Mapping[Effect, Array]) -> None:
        """Keep the residuals, and known effects with their sizes, (n_sizes,) each."""
        super().__init__(raw)
        self.by_motion = True
        self.known = dict(known)

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n)."""
        return residuals_by_motion(self.raw, *self._add_known(effects, sizes))

    def _add_known(self, effects: Sequence[Effect], sizes: Array) -> tuple[list[Effect], Array]:
        """Return all effects and their sizes, (n_candidates, [n_motions,] total sizes), within bounds."""
        terms = [*self.known.items()]
        terms += [
            (one.effect if isinstance(one, Change) else one, own) for one, own in split_sizes(effects, sizes)
        ]
        return add_sizes(terms, sizes.shape[:-1])

    def around(self, effects: Sequence[Effect], sizes: Array) -> "KnownResiduals":
        """Return the residuals with another reference: effects with their sizes, (1, total sizes)."""
        inner, total = self._add_known(effects, sizes)
        return KnownResiduals(refer_to(self.raw, inner, total[0]), self.known)

    def select(self, motions: Sequence[str]) -> "KnownResiduals":
        """Return the residuals of these motions alone, in their old order."""
        return KnownResiduals(self.raw.select(motions), self.known)

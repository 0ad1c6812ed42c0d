"""Propose the next motion of a robot: the one that tells the rivals of a finding apart best."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from simgap.arrays import Array, Flags
from simgap.common.errors import RobotError
from simgap.effects.effect import Size
from simgap.logs import Logs, Motion, Usable
from simgap.next_motion.family import (
    Plan,
    START_s,
    list_contacts,
    list_plans,
    list_touching,
    make_motion,
)
from simgap.next_motion.rivals import choose_rivals, is_sure
from simgap.next_motion.separation import Choice, Slopes, choose_motion, find_deviations
from simgap.residuals.conditioned import join_conditions
from simgap.residuals.noise import WhitenedResiduals, whiten_noise
from simgap.residuals.residuals import ResidualModel, refer_to
from simgap.residuals.simulation_residuals import PENALTY_rad, ResidualKind, SimulationResiduals, list_kinds
from simgap.result import Rival
from simgap.robot import Robot
from simgap.selection.fit import STEP, Union, scale_residuals

AT_ONCE: Final = 32
"""Motions that are simulated together, between two reports of the progress."""
SCREENED: Final = 0.3
"""Share of the time after the simulation of all motions, for the progress: of a servo arm."""
RUNS: Final = 4
"""Times that a motion is recorded: this halves its error, and other runs predict one that is left out."""
Report = Callable[[float, str], None]
"""Takes the share that is done and a text."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Predictions of one signal by the rivals in the best motion."""

    signal: str
    unit: str
    time_s: Array
    """(n,)."""
    values: Array
    """Predictions less their mean, (n_rivals, n)."""
    noise: float
    """Standard deviation of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """The next motion, and how well it and others tell the rivals of a finding apart."""

    finding: str
    """Key of the finding."""
    rivals: tuple[str, ...]
    """Keys of the rivals, the finding first."""
    is_sure: bool
    """Whether the logs exclude every rival already."""
    motions: tuple[str, ...]
    """All motions that were compared, in words."""
    choice: Choice
    curves: tuple[Curve, ...]
    """Of the best motion."""
    runs: int = 1
    """Times that it is recorded."""


def propose_motion(
    robot: Robot,
    logs: Logs,
    rivals: Sequence[Rival],
    usable: Usable | None = None,
    progress: Report = lambda share, text: None,
) -> tuple[Proposal, Motion]:
    """Propose the motion that tells the rivals of the finding in most doubt apart.

    Args:
        logs: Logs in which they were found.
        usable: Samples that took part.
        progress: Called with the share that is done, from 0 to 1, and a text.

    Returns:
        The proposal, and its best motion as it would be logged if joints went where they are sent.

    Raises:
        RobotError: There are no rivals, or no motion is possible.
    """
    group = choose_rivals(rivals)
    kind = next((one for one in list_kinds(robot, logs.fit, usable) if one.name == group[0].kind), None)
    if kind is None:
        raise RobotError(f"the logs allow no {group[0].kind}, by which the result was found; give its logs")
    places = [one.effect.rpartition(": ")[0] for one in group]
    plans = list_plans(robot, logs.fit, places, kind.name == SimulationResiduals.kind)
    if not plans:
        raise RobotError("no motion is possible within the logs or possible_rad; log motions of all joints")
    progress(0.0, "noise of the logs")
    family = _Family(robot, logs.fit, plans, kind, _Models(group))
    predictions: list[Array] = []
    for first in range(0, len(plans), AT_ONCE):
        predictions += family.predict(range(first, min(first + AT_ONCE, len(plans))))
        progress(SCREENED * len(predictions) / len(plans), "motions simulated")
    done: list[int] = []

    def differentiate(some: Sequence[int]) -> list[Slopes]:
        progress(1.0 - (1.0 - SCREENED) * 0.8 ** (len(done) / len(some)), "best motions compared")
        done.extend(some)
        return family.differentiate(some)

    choice = choose_motion(predictions, differentiate, [one.p for one in group])
    if not choice.motions:
        raise RobotError("in each motion a rival is faster than the logs or touches anew; log more motions")
    best = choice.motions[0]
    keys = tuple(one.effect for one in group)
    words = tuple(plan.describe(robot) for plan in plans)
    progress(1.0, "done")
    made = Proposal(group[0].finding, keys, is_sure(group), words, choice, family.draw(best), RUNS)
    return made, family.motion(best)


class _Models:
    """Rivals as points of one union of effects."""

    def __init__(self, rivals: Sequence[Rival]) -> None:
        self.union = Union(tuple({one.key: one for rival in rivals for one in rival.effects}.values()))
        self.points = np.zeros((len(rivals), len(self.union.sizes)))
        self.fitted = [self.union.columns(rival.effects[: rival.n_fitted]) for rival in rivals]
        for point, rival in zip(self.points, rivals, strict=True):
            point[self.union.columns(rival.effects)] = np.concatenate([*map(np.asarray, rival.sizes)])
        self.places = {one.effect.rpartition(": ")[0] for one in rivals}

    def neighbours(self, k: int) -> tuple[Array, Array]:
        """Return the points a step of each fitted size from a rival, and the steps in typical sizes."""
        sizes = self.union.sizes_at(self.fitted[k])
        steps = [_step(one, at) for one, at in zip(sizes, self.points[k, self.fitted[k]], strict=True)]
        points = np.repeat(self.points[k][None], len(sizes), axis=0)
        points[np.arange(len(sizes)), self.fitted[k]] += steps
        return points, np.array(steps) / [one.typical for one in sizes]

    def deviate(self, k: int, old: Array) -> tuple[Array, Array]:
        """Return what earlier motions leave possible beside a rival, and by how many standard deviations.

        Each independent change is made up and down, as far as bounds allow, and by a typical size at most.

        Args:
            old: Derivatives in the earlier motions, (n_old, n_fitted), in units of noise and typical size.

        Returns:
            Points (2 n_fitted, n), those down last, and deviations (n_fitted,), at most 1.
        """
        sizes, at = self.union.sizes_at(self.fitted[k]), self.points[k, self.fitted[k]]
        typical = np.array([one.typical for one in sizes])
        changes = find_deviations(old, np.array([one.prior_std for one in sizes]) / typical)
        share = 1.0 / np.maximum(np.abs(changes).max(axis=0, initial=0.0), 1.0)
        step = (typical[:, None] * changes * share).T
        points = np.repeat(self.points[k][None], 2 * len(sizes), axis=0)
        low, high = [one.low for one in sizes], [one.high for one in sizes]
        points[:, self.fitted[k]] = np.clip(at + np.concatenate([step, -step]), low, high)
        return points, share


def _step(size: Size, at: float) -> float:
    """Return a step that stays within the bounds of a size."""
    step = STEP * size.typical
    return step if at + step <= size.high else -step


class _Family:
    """Predictions of rivals for the motions of a family, in units of the noise of the logs."""

    def __init__(
        self,
        robot: Robot,
        motions: Sequence[Motion],
        plans: Sequence[Plan],
        kind: ResidualKind,
        models: _Models,
    ) -> None:
        self._robot, self._logged, self._plans = robot, motions[0], plans
        self._kind, self._models = kind, models
        self._is_simulated = kind.name == SimulationResiduals.kind
        union, found = models.union, models.points[0]
        earlier = refer_to(kind.make(motions, False), union.effects, found)
        (left,) = earlier.residuals(union.effects, found[None])
        white = whiten_noise(earlier, left)
        if not isinstance(white, WhitenedResiduals):
            white = WhitenedResiduals(earlier, neighbour_correlation(earlier, left))
        self._correlation, self._scales = white.correlation, scale_residuals(white, white.whiten(left))
        speeds, joint_of = _speeds(earlier, earlier.explain("position")), earlier.joint_of
        self._fastest = np.array([speeds[joint_of == j].max(initial=0.0) for j in range(len(earlier.joints))])
        self._touching = list_touching(robot, motions)
        rows, numbers = self._select(earlier), range(len(models.points))
        points, steps = zip(*map(models.neighbours, numbers), strict=True)
        every = np.concatenate([models.points, *points])
        values = self._whiten(white, earlier.residuals(union.effects, every))[:, rows]
        changes = _changes(values, [len(one) for one in points])
        old = [(change / step[:, None]).T for change, step in zip(changes, steps, strict=True)]
        self._moved, self._shares = zip(*map(models.deviate, numbers, old), strict=True)

    def motion(self, k: int) -> Motion:
        """Return a motion with the name of its number."""
        return make_motion(self._robot, self._plans[k], self._logged, str(k))

    def _select(self, model: ResidualModel) -> Flags:
        """Return the rows of the joints at the places of the rivals; of all joints for another place."""
        own = [j for j, name in enumerate(model.joints) if name in self._models.places]
        everywhere = len(own) < len(self._models.places)
        return np.isin(model.joint_of, range(len(model.joints)) if everywhere else own)

    def _whiten(self, white: WhitenedResiduals, residuals: Array) -> Array:
        return white.whiten(residuals) / self._scales[white.joint_of]

    def _simulate(self, some: Sequence[int], points: Array) -> tuple[ResidualModel, Array]:
        """Return a model of motions, and its residuals; NaN where a simulation blew up."""
        motions = [self.motion(k) for k in some]
        if not self._is_simulated:
            model = self._kind.make(motions, True)
            return model, model.residuals(self._models.union.effects, points)
        model = join_conditions(
            self._robot, motions, lambda one, own, _: SimulationResiduals(one, own, is_measured=False)
        )
        residuals, n = model.residuals(self._models.union.effects, points), len(self._models.points)
        is_known = np.abs(residuals) < PENALTY_rad
        moved = model.explain("position") - residuals[:n]
        # faster than in the logs, as at a resonance, grows what every rival lacks
        is_known[:n] &= _speeds(model, moved) <= self._fastest[model.joint_of]
        for k in range(len(some)):
            here = model.motion_of == k
            # every fifth sample: between two of them a joint turns little
            poses = np.hstack([*moved[:, here].reshape(n, len(model.joints), -1)[:, :, ::5]]).T
            is_known[:, here] &= list_contacts(self._robot, poses) <= self._touching
        return model, np.where(is_known, residuals, np.nan)

    def _compare(self, some: Sequence[int], points: Array) -> list[Array]:
        """Return whitened residuals of each motion after its start, (n_points, n)."""
        parts = []
        # the samples that inverse dynamics compares follow from all motions of a model
        for own in [some] if self._is_simulated else [[k] for k in some]:
            model, residuals = self._simulate(own, points)
            white = RUNS**0.5 * self._whiten(WhitenedResiduals(model, self._correlation), residuals)
            rows = self._select(model) & (model.time_s >= START_s)
            parts += [white[:, rows & (model.motion_of == m)] for m in range(len(own))]
        return parts

    def predict(self, some: Sequence[int]) -> list[Array]:
        """Return what the rivals predict for some motions, (n_rivals, n) each.

        It is halved: a verdict compares sums of squares, which differ by T with a standard error of 2 sqrt T.
        """
        return [0.5 * one for one in self._compare(some, self._models.points)]

    def differentiate(self, some: Sequence[int]) -> list[Slopes]:
        """Return the slopes of the rivals in some motions, beside them the bends.

        A rival's prediction over a standard deviation of a size need not be a line: of half the second
        difference too, one standard deviation is taken for possible.
        """
        parts = self._compare(some, np.concatenate([self._models.points, *self._moved]))
        return [[*map(find_slopes, _changes(one, [*map(len, self._moved)]), self._shares)] for one in parts]

    def draw(self, k: int) -> tuple[Curve, ...]:
        """Return what the rivals predict of each joint that is compared in a motion."""
        model, residuals = self._simulate([k], self._models.points)
        predicted, rows = residuals.mean(axis=0) - residuals, self._select(model) & (model.time_s >= START_s)
        return tuple(
            Curve(name, model.units[j], model.time_s[own], predicted[:, own], float(self._scales[j]))
            for j, name in enumerate(model.joints)
            if (own := rows & (model.joint_of == j)).any()
        )


def _changes(values: Array, numbers: Sequence[int]) -> list[Array]:
    """Return the changes of residuals from each rival to its own points, 0 where one blew up.

    Args:
        values: Residuals of the rivals, then those of their points, (n_rivals + the sum of `numbers`, n).
    """
    n = len(numbers)
    parts = np.split(values[n:], np.cumsum(numbers)[:-1])
    return [np.nan_to_num(part - one) for part, one in zip(parts, values[:n], strict=True)]


def find_slopes(changes: Array, share: Array) -> Array:
    """Return first differences and half the second ones, (n, 2 n_sizes), by one standard deviation.

    Args:
        changes: Of a prediction by each size up, then by each down, (2 n_sizes, n).
        share: Standard deviations that a size is changed by, (n_sizes,).
    """
    up, down = np.split(changes, 2)
    return np.concatenate([(up - down) / (2.0 * share[:, None]), (up + down) / (2.0 * share[:, None] ** 2)]).T


def _speeds(model: ResidualModel, positions: Array) -> Array:
    """Return speeds from positions at the rows of a model, (.., n); 0 at the first of a joint in a motion."""
    step_s = np.diff(model.time_s, prepend=np.inf)
    return np.asarray(np.where(step_s > 0.0, np.abs(np.diff(positions, prepend=0.0) / step_s), 0.0))


def neighbour_correlation(model: ResidualModel, residuals: Array) -> Array:
    """Return the correlation of neighbouring samples of residuals, (n,), at each joint, (n_joints,)."""
    follows = (np.diff(model.joint_of) == 0) & (np.diff(model.motion_of) == 0)
    product, energy = residuals[1:] * residuals[:-1], residuals[:-1] ** 2
    n = len(model.joints)
    joint_of = model.joint_of[:-1][follows]
    sums = [np.bincount(joint_of, weights=one[follows], minlength=n) for one in (product, energy)]
    return np.clip(sums[0] / np.maximum(sums[1], 1e-300), 0.0, 0.95)

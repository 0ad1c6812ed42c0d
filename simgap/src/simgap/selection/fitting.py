"""Fit many hypotheses together, which share their simulations.

scipy fits one problem at a time. Here all advance together, because an engine simulates a hundred candidates
at the price of ten. Hypotheses at different joints share a candidate where one joint scarcely moves another
(`sharing.py`).

Residuals are arrays (n,) in the unit of the model, scales (n_joints,) too.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.residuals.residuals import ResidualModel, residuals_by_motion
from simgap.selection.descent import Descent, Requests
from simgap.selection.fit import Hypothesis, JointFit, Union, select_rows
from simgap.selection.sharing import Point, Sharing

MAX_ITERATIONS: Final = 40
"""Most steps of a fit that goes on to its end. On the logs of the XL330, 36 of 37 fits converge before. With
12, sizes were judged far from their optimum, and no effect was found there.
"""
AT_ONCE: Final = 100
"""Most candidates in a call of the model: more cost as much each, and no progress would be told meanwhile."""
MEMORY_BYTES: Final = 50_000_000
"""Residuals of all candidates in a call of the model, or of all points that wait for each other."""
RIVAL_SHARE: Final = 0.5
"""Least decrease of the loss, over that of the best of the joint, or the least of the findings that are left
out, of an effect that is fitted to its end.
The test of a set would exclude what explains less of an effect that is strong enough for a name."""
FEW_ITERATIONS: Final = 4
"""Iterations before the first are given up, and again before the next. On the KR300, 4, 6 and 12 give one
result; with 2, a set lacks a member. With 8 and more differences, one more of nine sealed servos gets its
right name, and a diagnosis of the XL330 takes half as long again."""


class Fitting:
    """Hypotheses that are fitted together."""

    def __init__(
        self,
        model: ResidualModel,
        union: Union,
        hypotheses: Iterable[Hypothesis],
        scales: Array,
        *,
        sharing: Sharing,
        report: Callable[[int], None] | None = None,
    ) -> None:
        """Prepare the starts; `report` gets the number of candidates after each call of the model."""
        self.model = model
        self._evaluate = _Evaluator(model, union, sharing, report)
        self._start: Callable[[Hypothesis], Descent] = lambda one: Descent(model, union, one, scales, sharing)
        self.descents = [self._start(one) for one in hypotheses]
        """One for each hypothesis, until some are given up."""
        self.places = [*range(len(self.descents))]
        """Where each is in the list of hypotheses."""

    def advance(self, iterations: int = MAX_ITERATIONS, *, is_sure: bool = False) -> None:
        """Let all hypotheses go on for some iterations, or to what are or seem to be their optima."""
        self._run(self.descents, iterations, is_sure)

    def _run(self, descents: Sequence[Descent], iterations: int, is_sure: bool = False) -> None:
        running = [one.run(iterations, is_sure) for one in descents]
        asked = {one: points for one in running if (points := next(one, None))}
        while asked:
            go_on = {}
            for portion in _divide(asked, self.model):
                found = self._evaluate([asked[one] for one in portion])
                for one, answer in zip(portion, found, strict=True):
                    if points := _answer(one, answer):
                        go_on[one] = points
            asked = go_on

    def keep(self, places: Sequence[int]) -> None:
        """Give all hypotheses up but those at these places in the list of descents."""
        self.descents = [self.descents[k] for k in places]
        self.places = [self.places[k] for k in places]

    def compete(self, list_hopeful: Callable[[float], Sequence[int]], known: Sequence[JointFit] = ()) -> None:
        """Let hypotheses go on, and give up those that soon explain too little.

        `list_hopeful` returns the places in `descents` of those that explain this share of the best. Before
        it is asked for RIVAL_SHARE, those left begin again for as many iterations as they had.
        """
        self.advance(FEW_ITERATIONS)
        self.keep(list_hopeful(RIVAL_SHARE**2))
        self.advance(FEW_ITERATIONS)
        self.begin_again(2 * FEW_ITERATIONS, known)
        self.keep(list_hopeful(RIVAL_SHARE))

    def begin_again(self, iterations: int, known: Sequence[JointFit] = ()) -> None:
        """Let fits begin again with the sizes of the best fit of their joint; the better of both ends stays.

        Each has its own effect, and shares the others with that fit, which may be a known one. Joints that
        stick have many minima, and with one effect a fit may leave a poor one early.
        """
        again: dict[int, Descent] = {}
        for joint in dict.fromkeys(one.joint for one in self.descents):
            own = {k: one for k, one in enumerate(self.descents) if one.joint == joint}
            first = min(own.values(), key=lambda one: one.loss)
            fits = [(first.loss_of(one.residuals, one.sizes), one) for one in known if one.joint == joint]
            least, best = min([(first.loss, first.fit()), *fits], key=lambda pair: pair[0])
            again |= {k: self._start(one.begin_at(best)) for k, one in own.items() if one.loss > least}
        self._run([*again.values()], iterations)
        for k, one in again.items():
            self.descents[k] = min(self.descents[k], one, key=lambda one: one.loss)

    def finish(self) -> list[JointFit]:
        """Let all hypotheses go on to their optima."""
        self.advance(is_sure=True)
        return [one.fit() for one in self.descents]


def _divide(asked: dict[Requests, list[Point]], model: ResidualModel) -> list[list[Requests]]:
    """Put requests together whose residuals need no more than MEMORY_BYTES, or a single one that does."""
    portions: list[list[Requests]] = []
    room = -1
    for one, points in asked.items():
        needed = 8 * sum(len(select_rows(model, joint)) for joint, _ in points)
        if needed > room:
            portions.append([])
            room = MEMORY_BYTES
        room -= needed
        portions[-1].append(one)
    return portions


def _answer(descent: Requests, residuals: list[Array]) -> list[Point] | None:
    """Give a descent the residuals that it asked for; return what it asks for next, None at its end."""
    try:
        return descent.send(residuals)
    except StopIteration:
        return None


def evaluate_points(
    model: ResidualModel,
    union: Union,
    points: Sequence[Point],
    *,
    sharing: Sharing,
    report: Callable[[int], None] | None = None,
) -> list[Array]:
    """Simulate points in as few candidates as possible; return residuals of the joint of each, (n_rows,).

    Sizes are all (n_sizes,), or all (n_motions, n_sizes). Points of different joints share a candidate where
    `sharing` lets them. `report` gets the number of candidates after each call of the model.
    """
    (found,) = _Evaluator(model, union, sharing, report)([list(points)])
    return found


class _Evaluator:
    """Simulates the points of many problems in as few candidates as possible."""

    def __init__(
        self, model: ResidualModel, union: Union, sharing: Sharing, report: Callable[[int], None] | None
    ) -> None:
        self.model, self.union, self.sharing, self.report = model, union, sharing, report

    def __call__(self, points: list[list[Point]]) -> list[list[Array]]:
        """Return the residuals of its joint for each point of each problem."""
        where = [(k, i) for k, wanted in enumerate(points) for i in range(len(wanted))]
        flat = [points[k][i] for k, i in where]
        self.rows = {joint: select_rows(self.model, joint) for joint in {joint for joint, _ in flat}}
        plan = self.sharing.plan(flat)
        found: dict[int, Array] = {}
        at_once = max(1, min(AT_ONCE, MEMORY_BYTES // (4 * 8 * len(self.model.joint_of))))  # beside copies
        for first in range(0, len(plan), at_once):
            self.simulate(plan[first : first + at_once], flat, found)
        place = {one: number for number, one in enumerate(where)}
        return [[found[place[k, i]] for i in range(len(wanted))] for k, wanted in enumerate(points)]

    def simulate(self, plan: list[list[int]], points: list[Point], found: dict[int, Array]) -> None:
        """Simulate candidates, and add the residuals of each point to what is found."""
        merged = [self.sharing.merge([points[number] for number in numbers]) for numbers in plan]
        sizes = np.array(merged)
        used = np.flatnonzero(np.any(sizes != 0.0, axis=tuple(range(sizes.ndim - 1))))
        part = [self.union.effects[k] for k in np.unique(self.union.owner[used])]
        sizes = sizes[..., self.union.columns(part)]
        simulated = residuals_by_motion(self.model, part, sizes)
        for numbers, row in zip(plan, simulated, strict=True):
            for number in numbers:
                found[number] = row[self.rows[points[number][0]]]
        if self.report is not None:
            self.report(len(plan))

"""The simulator's answers without the simulator: parabolas through what was simulated once."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.hypothesis import Hypothesis
from ground.diagnosis.layout import Ints
from ground.diagnosis.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class Curved:
    """What effects change in the features; beyond what was simulated each goes on in a straight line."""

    found: Sensitivities

    def change(self, settings: Mapping[Hypothesis, Array]) -> Array:
        """By these values of all parameters of each effect, (m,); those that only shape change nothing."""
        total = np.zeros(self.found.layout.size)
        for hypothesis, values in settings.items():
            columns, t = self._departures(hypothesis, values)
            inside = self._inside(columns, t)
            total += self.found.effect[:, columns] @ t
            total += self.found.curve[:, columns] @ (inside * (2.0 * t - inside))
        return total

    def slopes(self, settings: Mapping[Hypothesis, Array], change: Array) -> Array:
        """By each parameter of each effect times its typical size, (m, n), whatever the change."""
        parts = []
        for hypothesis, values in settings.items():
            columns, t = self._departures(hypothesis, values)
            own = self.found.effect[:, columns]
            own = own + 2.0 * self.found.curve[:, columns] * self._inside(columns, t)
            part = np.zeros((self.found.layout.size, len(hypothesis.parameters)))
            part[:, [parameter.sizes for parameter in hypothesis.parameters]] = own
            parts.append(part)
        return np.hstack(parts)

    def _inside(self, columns: Ints, t: Array) -> Array:
        """The part of sizes that was simulated."""
        reach = self.found.reach[columns]
        return np.clip(t, -reach, reach)

    def _departures(self, hypothesis: Hypothesis, values: Array) -> tuple[Ints, Array]:
        """Its columns, and its sizes in typical ones."""
        columns = np.flatnonzero(self.found.owner == self.found.hypotheses.index(hypothesis))
        return columns, hypothesis.departures(values)

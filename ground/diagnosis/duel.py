"""Two that explain a case nearly as well, each beside nuisances of its own: who leaves less.

Where nuisances are depends on what they are fitted beside. Two kinds of friction at one joint may be as
likely, though beside the nuisances of the one the other is far off: no straight line leads from one to it.
"""

from dataclasses import dataclass

from ground.diagnosis.race import Chosen
from ground.diagnosis.refine import Refined


@dataclass(frozen=True, slots=True, eq=False)
class Duel:
    """Who won, and against whom."""

    chosen: Chosen
    final: Refined
    """What won, with the simulator, beside nuisances of its own."""
    rival: Chosen
    worse: float
    """By how much, in deviance; parameters count. Infinite if the rival is at a bound, and no finding."""

    def instead_of(self, one: int, chosen: Chosen) -> int | None:
        """What the rival has in the place of one, if what won the duel was chosen in the end, too."""
        others = set(chosen) - {one}
        if set(chosen) != set(self.chosen) or one in self.rival or not others < set(self.rival):
            return None
        (other,) = set(self.rival) - others
        return other

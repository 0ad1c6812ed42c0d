"""Two that explain a case nearly as well, each beside nuisances of its own: who leaves less.

Where nuisances are depends on what they are fitted beside. Two kinds of friction at one joint may be as
likely, though beside the nuisances of the one the other is far off: no straight line leads from one to it.
"""

from dataclasses import dataclass

from ground.gap.race import Chosen
from ground.gap.refine import Refined


@dataclass(frozen=True, slots=True, eq=False)
class Duel:
    """Who won, and against whom."""

    chosen: Chosen
    final: Refined
    """What won, with the simulator, beside nuisances of its own."""
    rival: Chosen
    worse: float
    """Deviance that the rival leaves, less what that leaves which won."""

    def instead_of(self, one: int, chosen: Chosen) -> int | None:
        """What the rival has in the place of one of those chosen in the end, if it has all others."""
        different = set(self.rival) - (set(chosen) - {one})
        if one in self.rival or len(self.rival) != len(chosen) or len(different) != 1:
            return None
        return different.pop()

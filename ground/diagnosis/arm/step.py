"""By how large steps an effect is simulated: a few times what the campaign can see of it.

Much less would be lost in the rounding of counters and in how gears happen to come to rest; much more, and
gaps change sides and tools touch, which says nothing of small sizes. What can be seen is known only beside
the nuisances, so a typical size is tried, and mended.
"""

import math
from typing import Final

SEEN: Final = 15.0
"""Standard errors beside the nuisances that a step is to be: 4.6 times the limit of detection."""
NEAR_ENOUGH: Final = 2.0
"""A step is mended if it is that many times too large or too small."""
LEAST_SHARE: Final = 1e-3
MOST_SHARE: Final = 2.0
"""Of a typical size."""
ROUNDS: Final = 3
"""That steps are mended in."""


def off(seen: float) -> float:
    """How far a step that is so many standard errors is from what it should be; infinite if it is unseen."""
    return abs(math.log(seen / SEEN)) if seen else math.inf


def mended(share: float, seen: float) -> float | None:
    """Another share for a step that is so many standard errors; None if none would be better."""
    if not seen or 1.0 / NEAR_ENOUGH <= seen / SEEN <= NEAR_ENOUGH:
        return None
    better = min(max(share * SEEN / seen, LEAST_SHARE), MOST_SHARE)
    return None if 1.0 / NEAR_ENOUGH < better / share < NEAR_ENOUGH else better

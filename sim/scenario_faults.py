"""The faults of the hardware that a scenario may inject."""

from dataclasses import replace
from typing import Final

from sim.effects.effect import Effect
from sim.effects.environment import PowerLoss

FAULTS: Final[tuple[type[Effect], ...]] = (PowerLoss,)
"""Each is a frozen dataclass with a time `at_s`; that and its fields are what a file says of it."""

STOPPING: Final[tuple[type[Effect], ...]] = (PowerLoss,)
"""Those with which no command that moves can come to its end."""


def timed(effect: Effect, at_s: float) -> Effect:
    """The same fault at another time."""
    when = {"at_s": at_s}
    return replace(effect, **when)

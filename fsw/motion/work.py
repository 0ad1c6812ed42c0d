"""Work of planning that is done piece by piece, so that each cycle does a bounded part of it.

A piece of work is a frozen record: what was found so far, and what comes next. It is a part of the state of
flight software, as all else that a cycle leaves for the next one.
"""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from fsw.config import Config

Result = TypeVar("Result", covariant=True)
Whole = TypeVar("Whole")


class Work(ABC, Generic[Result]):
    """Work that is not done yet, and that has this result in the end."""

    __slots__ = ()

    @abstractmethod
    def advance(self, config: Config) -> "Work[Result] | Result":
        """Do the next piece: return the work that is left, or the result if none is."""


def complete(config: Config, work: Work[Whole]) -> Whole:
    """Do all the work at once, as tools on the ground do, which have the time."""
    left: Work[Whole] | Whole = work
    while isinstance(left, Work):
        left = left.advance(config)
    return left

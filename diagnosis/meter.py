"""Share of a selection that is done, from the rounds and the simulated candidates that are still expected."""

from collections.abc import Callable, Sequence
from typing import Final

Progress = Callable[[float, str], None]

FIRST_RATIO: Final = 3.0
"""Candidates of the first round over those of its screening: refits are taken to cost twice as much."""
OVERRUN: Final = 0.1
"""Share of its candidates that a round has left once it has more than were expected."""


class Meter:
    """Counts candidates. The share stays 0 until the base parameters are fitted, and never falls."""

    def __init__(self, progress: Progress = lambda share, text: None) -> None:
        """Start at 0.

        Args:
            progress: Called with the share that is done, from 0 to 1, and a text.
        """
        self._progress = progress
        self._share, self._is_silent = 0.0, False
        self._done, self._begin = 0, 0
        self._screened, self._after = 0, 0
        self._ended_done, self._ended_screened = 0, 0

    @property
    def counts(self) -> list[float]:
        """Return all counts, with which `restore` goes on."""
        rounds = (self._begin, self._screened, self._after, self._ended_done, self._ended_screened)
        return [self._share, self._done, *rounds]

    def restore(self, counts: Sequence[float]) -> None:
        """Take the counts of an earlier run, and report nothing before `go_on`.

        Args:
            counts: Counts of a meter.
        """
        self._is_silent = True
        self._share, done, *rounds = counts
        self._done = int(done)
        self._begin, self._screened, self._after, self._ended_done, self._ended_screened = map(int, rounds)

    def go_on(self) -> None:
        """Report again: what an earlier run has done took no time, and ends here."""
        if self._is_silent:
            self._is_silent = False
            self.advance("going on", 0)

    def begin_round(self, screened: int, after: int) -> None:
        """Begin a round of screening and refits.

        Args:
            screened: Candidates of its screening.
            after: Rounds that are expected after it.
        """
        if self._screened:
            self._ended_done += self._done - self._begin
            self._ended_screened += self._screened
        self._begin, self._screened, self._after = self._done, screened, after

    def advance(self, text: str, count: int) -> None:
        """Count candidates.

        Args:
            text: Name of the work.
            count: Number of candidates that were simulated.
        """
        self._done += count
        if self._screened:
            ratio = self._ended_done / self._ended_screened if self._ended_screened else FIRST_RATIO
            usual, spent = ratio * self._screened, self._done - self._begin
            left = max(usual - spent, OVERRUN * spent) + self._after * usual
            self._share = max(self._share, self._done / (self._done + left))
        if not self._is_silent:
            self._progress(self._share, text)

"""Share of a selection that is done, from the rounds and the simulated candidates that are still expected."""

from collections.abc import Callable, Sequence
from typing import Final

Progress = Callable[[float, str], None]

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
        self._expected, self._after = 0, 0.0
        self._ended_done, self._ended_expected = 0, 0

    @property
    def counts(self) -> list[float]:
        """Return all counts, with which `restore` goes on."""
        rounds = (self._begin, self._expected, self._after, self._ended_done, self._ended_expected)
        return [self._share, self._done, *rounds]

    def restore(self, counts: Sequence[float]) -> None:
        """Take the counts of an earlier run, and report nothing before `go_on`.

        Args:
            counts: Counts of a meter.
        """
        self._is_silent = True
        self._share, done, begin, expected, self._after, ended_done, ended_expected = counts
        self._done, self._begin, self._expected = int(done), int(begin), int(expected)
        self._ended_done, self._ended_expected = int(ended_done), int(ended_expected)

    def go_on(self) -> None:
        """Report again: what an earlier run has done took no time, and ends here."""
        if self._is_silent:
            self._is_silent = False
            self.advance("going on", 0)

    def begin_round(self, expected: int, after: float) -> None:
        """Begin a round of screening and refits.

        Args:
            expected: Candidates that it should take; later rounds are scaled by what earlier ones took.
            after: Rounds that are expected after it.
        """
        if self._expected:
            self._ended_done += self._done - self._begin
            self._ended_expected += self._expected
        self._begin, self._expected, self._after = self._done, expected, after

    def advance(self, text: str, count: int) -> None:
        """Count candidates.

        Args:
            text: Name of the work.
            count: Number of candidates that were simulated.
        """
        self._done += count
        if self._expected:
            ratio = self._ended_done / self._ended_expected if self._ended_expected else 1.0
            usual, spent = ratio * self._expected, self._done - self._begin
            left = max(usual - spent, OVERRUN * spent) + self._after * usual
            self._share = max(self._share, self._done / (self._done + left))
        if not self._is_silent:
            self._progress(self._share, text)

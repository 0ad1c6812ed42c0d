"""Progress of long work: its interface, and its output on standard error with the time left.

On a terminal it is a bar. Elsewhere, in a file or a pipe, it is a line after a second, then ever more rarely.
The time left follows from an earlier run for the same request on this machine. Without one it follows from
the share done, as a range while a step of the work lasts, or where that share is a guess.
"""

import json
import os
import sys
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain, repeat
from pathlib import Path
from threading import Event, Thread
from typing import Final, Self

from simgap.common.files import atomic_path, cache_folder
from simgap.common.interruption import block_signals

LEAST_S: Final = 5.0
"""Shortest duration of a run that is kept: a shorter one needs no time left."""
STEP: Final = 0.01
"""Least share between two points that are kept."""
PRIOR_S: Final = 1.0
"""Time that a run is taken to have been as fast as the earlier one.

The larger it is, the later the estimate follows a run of another size: after 10 s of one ten times as long,
it is 0.55 of the truth with 1 s, and 0.4 with 2 s. The smaller it is, the more counts the start of Python.
"""


@dataclass(frozen=True, slots=True)
class EarlierRun:
    """Times at which an earlier run had done some shares of its work; both rise, from 0 and to the end."""

    shares: tuple[float, ...]
    times_s: tuple[float, ...]

    @classmethod
    def of_points(cls, points: Sequence[tuple[float, float]], total_s: float) -> Self:
        """Make the course of a run from reports of share and time since the start, which never fall."""
        kept = [(0.0, 0.0)]
        for share, time_s in points:
            if share >= kept[-1][0] + STEP and share < 1.0:
                kept.append((share, time_s))
        shares, times_s = zip(*kept, (1.0, total_s), strict=True)
        return cls(shares, times_s)

    def left_s(self, first_share: float, share: float, spent_s: float, since_s: float) -> float:
        """Estimate the time left of a run, which is as fast in its rest as it was until now.

        Args:
            first_share: Share that was done before it began.
            share: Share that is done.
            spent_s: Time from its begin until this share was done.
            since_s: Time since then.
        """
        begin_s, _ = self._between(first_share)
        reached_s, next_s = (time_s - begin_s for time_s in self._between(share))
        total_s = self.times_s[-1] - begin_s
        pace = max(
            (spent_s + PRIOR_S) / (reached_s + PRIOR_S),
            (spent_s + since_s + PRIOR_S) / (next_s + PRIOR_S),  # the next share is not yet done
        )
        return max(pace * (total_s - reached_s) - since_s, pace * (total_s - next_s))

    def _between(self, share: float) -> tuple[float, float]:
        """Return when this share was done, and when the next one that was reported."""
        after = min(bisect_right(self.shares, share), len(self.shares) - 1)
        low, high = self.shares[after - 1], self.shares[after]
        begin_s, end_s = self.times_s[after - 1], self.times_s[after]
        return begin_s + (end_s - begin_s) * min((share - low) / (high - low), 1.0), end_s


def read_earlier_run(job: str, request: str) -> EarlierRun | None:
    """Return the course of the last run of a job that was kept; None unless it was for this request."""
    try:
        document = json.loads(_path(job).read_text())
        points = [(float(share), float(time_s)) for share, time_s in document["points"]]
        same = document["request"] == [os.getcwd(), request]  # relative paths name other files elsewhere
        return EarlierRun.of_points(points[:-1], points[-1][1]) if same else None
    except (OSError, ValueError, TypeError, IndexError, KeyError):  # absent, torn or of another version
        return None


def keep_run(job: str, request: str, run: EarlierRun) -> None:
    """Keep the course of a run, unless it was short; where nothing can be written, nothing is kept."""
    if run.times_s[-1] < LEAST_S:
        return
    path = _path(job)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as part:
            points = [*zip(run.shares, run.times_s, strict=True)]
            part.write_text(json.dumps({"request": [os.getcwd(), request], "points": points}))


def _path(job: str) -> Path:
    return cache_folder("simgap", "progress") / f"{job}.json"


Progress = Callable[[float, float, str], None]
"""Function of the amount done, the total amount, and the name of the current activity."""

GUESS: Final = -1.0
"""Total amount of work whose share done is a guess, as what is found decides how much is left."""
GUESS_SPREAD: Final = 2.0
"""Factor by which the time left may be larger or smaller than that which follows from a guessed share."""

WAITS_S: Final = (1.2, 8.8, 20.0, 30.0, 60.0)
"""Times before each line where there is no terminal; the last one is repeated.

Most bad input is refused before the first line, which comes within 2 s of the start of Python.
"""

MOST_SPREAD: Final = 1.5
"""Ratio of the most to the least time left up to which the most stands for both."""


def part_of(progress: Progress, begin: float, end: float) -> Progress:
    """Make the progress of one stage, which begins and ends at these shares of the whole work."""

    def update(done: float, total: float, what: str) -> None:
        if total == 0:
            progress(0.0, 0.0, what)
            return
        share = min(done / abs(total), 1.0)
        progress(begin + (end - begin) * share, GUESS if total < 0 else 1.0, what)

    return update


def as_guess(progress: Progress) -> Progress:
    """Make the progress of work whose share done is a guess."""
    return lambda done, total, what: progress(done / abs(total) if total else 0.0, total and GUESS, what)


@dataclass(slots=True)
class ProgressState:
    """State of some work, and the estimate of its time left."""

    started_s: float
    """Time of the start, of a monotonic clock."""
    earlier: EarlierRun | None = None
    """Earlier run for the same request; None if none was kept."""
    what: str = "starting"
    share: float = 0.0
    """Share of the work that is done; it never falls."""
    is_guess: bool = False
    """Whether the last report was a guess of the share."""
    reached_s: float = float("-inf")
    """Time at which this share was done."""
    first_share: float | None = None
    """Share at the first report: results of an earlier command, which took no time."""
    first_s: float = 0.0
    """Time of the first report."""
    n_reports: int = 0
    """Reports, which show that the work goes on while no share of it is known to be done."""
    points: list[tuple[float, float]] = field(default_factory=list)
    """Share, and time since the start, of reports that are STEP apart: those that are kept."""

    def update(self, done: float, total: float, what: str, now_s: float) -> None:
        """Take a report of progress at a time of the clock.

        A total of 0 means that nobody knows yet how much of the work an earlier command has done.
        """
        self.what = what
        self.n_reports += 1
        if total == 0:
            return
        self.is_guess, share = total < 0, min(done / abs(total), 1.0)
        if share > self.share:
            self.share, self.reached_s = share, now_s
        if self.share >= (self.points[-1][0] if self.points else 0.0) + STEP:  # long work reports millions
            self.points.append((self.share, now_s - self.started_s))
        if self.first_share is None:
            self.first_share, self.first_s = self.share, now_s

    def left_s(self, now_s: float) -> tuple[float, float] | None:
        """Estimate the least and the most time left; None before there is an estimate.

        The least is right if the present step ends now, the most if nothing of it is done. A guessed share
        divides and multiplies them by GUESS_SPREAD; the first STEP of it tells more of the start than of the
        work. A step that lasts longer than all that was left refutes the guess.
        """
        first, reached_s = self.first_share or 0.0, self.reached_s
        if self.share >= 1.0:
            return 0.0, 0.0
        if self.earlier is not None:
            begun_s = self.first_s if first else self.started_s
            reached_s = max(reached_s, begun_s)
            left_s = self.earlier.left_s(first, self.share, reached_s - begun_s, now_s - reached_s)
            return (left_s, left_s) if left_s > 0.0 else None  # the last step takes longer than it did
        if reached_s <= self.first_s or (self.is_guess and self.share < first + STEP):
            return None
        spread = GUESS_SPREAD if self.is_guess else 1.0
        rest = (1.0 - self.share) / (self.share - first)
        least_s = (reached_s - self.first_s) * rest - (now_s - reached_s)
        if self.is_guess and least_s <= 0.0:
            return None
        return max(least_s, 0.0) / spread, (now_s - self.first_s) * rest * spread

    def left_text(self, now_s: float) -> str:
        """Return the time left as text."""
        left_s = self.left_s(now_s)
        if left_s is None:
            return "time left not known"
        least, most = map(format_duration, left_s)
        return f"{most} left" if left_s[1] <= MOST_SPREAD * left_s[0] else f"{least} to {most} left"

    def line(self, now_s: float) -> str:
        """Return the state as one line of text."""
        spent = format_duration(now_s - self.started_s)
        done = f"{self.share:.0%}" if self.share > 0.0 or self.n_reports < 2 else f"step {self.n_reports}"
        return f"{self.what}: {done} after {spent}, {self.left_text(now_s)}"


def format_duration(duration_s: float) -> str:
    """Format a duration as a person says it: 40 s, 12 min, 3 h 20 min."""
    if duration_s < 99.5:
        return f"{duration_s:.0f} s"
    minutes = round(duration_s / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


def no_progress(done: float, total: float, what: str) -> None:
    """Show nothing."""


@contextmanager
def show_progress(job: str, request: str) -> Iterator[Progress]:
    """Show the progress and the time left of the work in a block; give the function that updates it.

    Args:
        job: Name of the work, under which its course is kept for the next time.
        request: What it is asked for, such as the words of the command line.
    """
    state = ProgressState(time.monotonic(), read_earlier_run(job, request))
    has_bar = sys.stderr.isatty() and os.environ.get("TERM") != "dumb"
    with (_show_bar if has_bar else _print_lines)(state) as refresh:

        def update(done: float, total: float, what: str) -> None:
            state.update(done, total, what, time.monotonic())
            refresh()

        yield update
    if not state.first_share:  # what an earlier command has done took no time
        keep_run(job, request, EarlierRun.of_points(state.points, time.monotonic() - state.started_s))


@contextmanager
def _show_bar(state: ProgressState) -> Iterator[Callable[[], None]]:
    from rich import progress as rich_progress
    from rich.console import Console
    from rich.text import Text

    class Left(rich_progress.ProgressColumn):
        def render(self, task: rich_progress.Task) -> Text:
            return Text(state.left_text(time.monotonic()))

    columns = (
        rich_progress.TextColumn("{task.description:<12}"),
        rich_progress.BarColumn(),
        rich_progress.TextColumn("{task.percentage:>3.0f} %"),
        rich_progress.TimeElapsedColumn(),
        Left(),
    )
    with rich_progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(state.what, total=1.0)
        yield lambda: bar.update(task, completed=state.share, description=state.what)


@contextmanager
def _print_lines(state: ProgressState) -> Iterator[Callable[[], None]]:
    """Print lines in a thread, so that one comes also while a step of the work lasts."""
    done = Event()

    def print_lines() -> None:
        for wait_s in chain(WAITS_S, repeat(WAITS_S[-1])):
            if done.wait(wait_s):
                return
            print(state.line(time.monotonic()), file=sys.stderr, flush=True)

    with block_signals():  # the main thread receives them
        Thread(target=print_lines, daemon=True).start()
    try:
        yield lambda: None
    finally:
        done.set()

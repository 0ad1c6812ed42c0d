"""Course of an earlier run of a command, from which the next one knows its time left."""

import json
from bisect import bisect_right
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from simgap.common.files import atomic_path, cache_folder

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
    request: str = ""
    """What the run was asked for."""

    @classmethod
    def of_points(cls, points: Sequence[tuple[float, float]], total_s: float, request: str = "") -> Self:
        """Make the course of a run from reports of share and time since the start, which never fall."""
        kept = [(0.0, 0.0)]
        for share, time_s in points:
            if share >= kept[-1][0] + STEP and share < 1.0:
                kept.append((share, time_s))
        shares, times_s = zip(*kept, (1.0, total_s), strict=True)
        return cls(shares, times_s, request)

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


def read_earlier_run(job: str) -> EarlierRun | None:
    """Return the course of the last run of a job that was kept; None if there is none."""
    try:
        document = json.loads(_path(job).read_text())
        points = [(float(share), float(time_s)) for share, time_s in document["points"]]
        return EarlierRun.of_points(points[:-1], points[-1][1], str(document["request"]))
    except (OSError, ValueError, TypeError, IndexError, KeyError):  # absent, torn or of another version
        return None


def keep_run(job: str, run: EarlierRun) -> None:
    """Keep the course of a run, unless it was short; where nothing can be written, nothing is kept."""
    if run.times_s[-1] < LEAST_S:
        return
    path = _path(job)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as part:
            points = [*zip(run.shares, run.times_s, strict=True)]
            part.write_text(json.dumps({"request": run.request, "points": points}))


def _path(job: str) -> Path:
    return cache_folder("simgap", "progress") / f"{job}.json"

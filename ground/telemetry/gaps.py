"""What is missing between the undamaged chunks of a log: the sequence of each channel tells."""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.telemetry.chunks import HEAD, MESSAGE_HEAD
from ground.telemetry.loss import Lost


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """A chunk whose CRC holds: its records, and the heads of its messages, type HEAD, shape (n,)."""

    plain: bytes
    starts: list[int]
    heads: NDArray[np.void]

    def messages(self) -> Iterator[tuple[int, int, int, int, bytes]]:
        """Channel, sequence, log time, publish time and body of each message."""
        for start, head in zip(self.starts, self.heads.tolist(), strict=True):
            _, length, *rest = head
            begin = start + HEAD.itemsize
            yield (*rest, self.plain[begin : begin + length - MESSAGE_HEAD])


@dataclass(frozen=True, slots=True)
class Gap:
    """Messages missing of a channel: they stood behind chunk `after` and before chunk `before`."""

    channel: int
    count: int
    after: int
    before: int


def gaps_in(chunks: Sequence[Saved], numbers: Set[int], totals: Mapping[int, int]) -> list[Gap]:
    """Where the sequences of these channels break off; `totals` tell what is missing at the end."""
    heads = np.concatenate([np.zeros(0, HEAD), *(chunk.heads for chunk in chunks)])
    of_chunk = np.repeat(np.arange(len(chunks)), [len(chunk.heads) for chunk in chunks])
    gaps = []
    for number in sorted(numbers | set(heads["channel"].tolist())):
        rows = np.flatnonzero(heads["channel"] == number)
        counted = heads["sequence"][rows].astype(np.int64)
        before = np.append(-1, counted)
        for k in np.flatnonzero(np.diff(before) > 1):
            gaps.append(
                Gap(
                    channel=number,
                    count=int(counted[k] - before[k] - 1),
                    after=-1 if k == 0 else int(of_chunk[rows[k - 1]]),
                    before=int(of_chunk[rows[k]]),
                )
            )
        missing = totals.get(number, 0) - int(before[-1]) - 1
        if missing > 0:
            behind = int(of_chunk[rows[-1]]) if len(rows) else -1
            gaps.append(Gap(number, missing, behind, len(chunks)))
    return gaps


def lost_between(
    chunks: Sequence[Saved],
    names: Mapping[int, str],
    known: Set[int],
    totals: Mapping[int, int] | None,
    is_complete: bool,
) -> tuple[Lost, ...]:
    """What is missing before, between and after these chunks; `names` has the topics of channels.

    Messages of channels that are not `known` cannot be told from noise, and are lost as well. Unless the log
    `is_complete`, nobody knows what came after its end.
    """
    chunks = [chunk for chunk in chunks if len(chunk.heads)]
    heads = np.concatenate([np.zeros(0, HEAD), *(chunk.heads for chunk in chunks)])
    gaps = gaps_in(chunks, known, totals or {})
    # A channel that speaks in every chunk shows at which seam something is missing; a rare one does not.
    seams = sorted({gap.after for gap in gaps if gap.before == gap.after + 1})
    ends = [int(chunk.heads["time_ns"].max()) for chunk in chunks]
    begins = [int(chunk.heads["time_ns"].min()) for chunk in chunks]

    def lost_at(number: int, count: int | None, first: int, last: int) -> Lost:
        """Messages lost from behind one chunk to before the one behind another."""
        after_ns = ends[first] if first >= 0 else None
        before_ns = begins[last + 1] if last + 1 < len(chunks) else None
        return Lost(names.get(number, f"channel {number}"), count, after_ns, before_ns)

    lost = []
    for gap in gaps:
        inside = [seam for seam in seams if gap.after <= seam < gap.before] or [gap.after, gap.before - 1]
        lost.append(lost_at(gap.channel, gap.count, inside[0], inside[-1]))
    for number in sorted(known) if totals is None else ():
        # Of a channel that is silent afterwards, nothing tells whether it spoke at a seam.
        speaks = [k for k, chunk in enumerate(chunks) if (chunk.heads["channel"] == number).any()]
        behind = [seam for seam in seams if seam >= max(speaks, default=-1)]
        if behind:
            lost.append(lost_at(number, None, behind[0], behind[-1]))
    for number in sorted(set(heads["channel"].tolist()) - known):
        count = int((heads["channel"] == number).sum())
        lost.append(Lost(names.get(number, f"channel {number}"), count, None, None))
    if not is_complete:
        lost.append(Lost(None, None, max(ends, default=None), None))
    return tuple(lost)

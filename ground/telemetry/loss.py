"""What a damaged log has lost, and the error that tells it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ground.telemetry.errors import LogCorrupt


@dataclass(frozen=True, slots=True)
class Lost:
    """Messages that were written and cannot be read any more; None where nothing tells."""

    topic: str | None
    """None: of all topics."""
    count: int | None
    after_ns: int | None
    """Log time of the last message before them; None: they are from the beginning."""
    before_ns: int | None
    """Log time of the first message behind them; None: nothing follows."""

    @property
    def sentence(self) -> str:
        """What was lost, in words."""
        count = "an unknown number of" if self.count is None else str(self.count)
        messages = "message" if self.count == 1 else "messages"
        return f"{count} {messages} of {self.topic or 'all topics'} lost, {self.when}"

    @property
    def when(self) -> str:
        """The span of time, in words."""
        return span_text(self.after_ns, self.before_ns)


def span_text(after_ns: int | None, before_ns: int | None) -> str:
    """A span of log time in words."""
    match after_ns, before_ns:
        case None, None:
            return "at an unknown time"
        case None, int():
            return f"before {before_ns / 1e9:.6f} s"
        case int(), None:
            return f"after {after_ns / 1e9:.6f} s"
        case _:
            return f"between {(after_ns or 0) / 1e9:.6f} s and {(before_ns or 0) / 1e9:.6f} s"


def outline(lost: Sequence[Lost]) -> str:
    """All that was lost in one clause: how much of how many topics, and the span around it."""
    if not lost:
        return "no message was lost"
    after = None if any(one.after_ns is None for one in lost) else min(one.after_ns or 0 for one in lost)
    before = None if any(one.before_ns is None for one in lost) else max(one.before_ns or 0 for one in lost)
    known = sum(one.count or 0 for one in lost)
    count = f"{known} messages" if all(one.count is not None for one in lost) else f"{known} or more messages"
    topics = sorted({one.topic for one in lost if one.topic is not None})
    of = f" of {', '.join(topics)}" if topics else ""
    return f"{count}{of} lost, {span_text(after, before)}"


class LogDamaged(LogCorrupt):  # says what is so
    """The bytes of a log are not those that were written; `lost` is what cannot be read for it."""

    def __init__(self, path: Path, why: str, offset: int, lost: Sequence[Lost]) -> None:
        super().__init__(path, f"{why}, {outline(lost)}", offset)
        self.lost = tuple(lost)

"""Messages that a damaged log has lost, as records, text and metadata; and the error of such a log."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from marsarm.telemetry.errors import LogError
from marsarm.telemetry.format import header_crc32

RECOVERED_RECORD: Final = "marsarm.recovered"
"""Name of the metadata that lists what a recovered log has lost."""
MAX_SPANS: Final = 3
"""Spans of time that one sentence names."""


@dataclass(frozen=True, slots=True)
class LostMessages:
    """Messages that were written and cannot be read any more; None stands for unknown."""

    topic: str | None
    """Topic of the messages; None for all topics."""
    count: int | None
    after_ns: int | None
    """Log time of the last message before the damage; None if the damage is at the beginning."""
    before_ns: int | None
    """Log time of the first message after the damage; None if no message follows."""

    @property
    def sentence(self) -> str:
        """Sentence: how many messages of which topic were lost, and when."""
        count = "an unknown number of" if self.count is None else str(self.count)
        messages = "message" if self.count == 1 else "messages"
        return f"{count} {messages} of {self.topic or 'all topics'} lost, {self.when}"

    @property
    def when(self) -> str:
        """Span of log time as text."""
        return span_text(self.after_ns, self.before_ns)


def span_text(after_ns: int | None, before_ns: int | None) -> str:
    """Format a span of log time."""
    match after_ns, before_ns:
        case None, None:
            return "at an unknown time"
        case None, int():
            return f"before {before_ns / 1e9:.6f} s"
        case int(), None:
            return f"after {after_ns / 1e9:.6f} s"
        case _:
            return f"between {(after_ns or 0) / 1e9:.6f} s and {(before_ns or 0) / 1e9:.6f} s"


def trailing_bytes_text(size: int) -> str:
    """Format the note about bytes after the end of the log."""
    return f"{size} bytes after the end of the log are left out; a file holds one log"


def interruption_text(interrupted_by: str) -> str:
    """Format the note about the log of an interrupted run."""
    return f"the run was interrupted by {interrupted_by}; the log ends there"


def summarize_losses(lost: Sequence[LostMessages]) -> str:
    """Summarize all losses in one clause: how many messages of which topics, and when."""
    if not lost:
        return "no message was lost"
    known = sum(one.count or 0 for one in lost)
    count = f"{known} messages" if all(one.count is not None for one in lost) else f"{known} or more messages"
    topics = sorted({one.topic for one in lost if one.topic is not None})
    of = f" of {', '.join(topics)}" if topics else ""
    spans = list(dict.fromkeys(one.when for one in lost))
    more = "" if len(spans) <= MAX_SPANS else f" and in {len(spans) - MAX_SPANS} more spans"
    return f"{count}{of} lost, {', '.join(spans[:MAX_SPANS])}{more}"


def loss_metadata(lost: Sequence[LostMessages]) -> dict[str, str]:
    """Return the metadata that lists the losses in a recovered log, with a CRC."""
    record = {"lost": json.dumps([asdict(one) for one in lost])}
    return record | {"crc32": header_crc32(record)}


def losses_in(record: Mapping[str, str]) -> tuple[LostMessages, ...]:
    """Read the metadata that `loss_metadata` made; an empty record lists no loss.

    Raises:
        ValueError, TypeError: the record is damaged.
    """
    if not record:
        return ()
    if record.get("crc32") != header_crc32({"lost": record.get("lost", "")}):
        raise ValueError("what the log says of a recovery does not match its CRC")
    return tuple(LostMessages(**one) for one in json.loads(record["lost"]))


class LogDamaged(LogError):
    """Error of a log whose bytes changed after it was written."""

    def __init__(self, path: Path, why: str, offset: int, lost: Sequence[LostMessages]) -> None:
        """Compose the message; `offset` is the byte where the damage shows, `lost` what cannot be read."""
        advice = (
            "the file was changed after it was written, and `marsarm log recover` saves what is undamaged"
        )
        super().__init__(path, f"{why}, {summarize_losses(lost)} (byte {offset}); {advice}")
        self.offset = offset
        self.lost = tuple(lost)

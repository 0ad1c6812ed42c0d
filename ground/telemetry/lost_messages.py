"""What a damaged log has lost, and the error that tells it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from ground.telemetry.errors import LogCorrupt
from ground.telemetry.format import header_crc32

RECOVERED_RECORD: Final = "marsarm.recovered"
"""Metadata of a recovered log: what could not be saved."""
MAX_SPANS: Final = 3
"""So many spans of time are named in a sentence."""


@dataclass(frozen=True, slots=True)
class LostMessages:
    """Messages that were written and cannot be read any more; None where nothing tells."""

    topic: str | None
    """None: of all topics."""
    count: int | None
    after_ns: int | None
    """Log time of the last message in front of the damage; None: it is at the beginning."""
    before_ns: int | None
    """Log time of the first message behind the damage; None: nothing follows."""

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


def trailing_bytes_text(size: int) -> str:
    """What is said of a file that goes on behind the end of its log."""
    return f"{size} bytes behind the end of the log are left out; a file holds one log"


def summarize_losses(lost: Sequence[LostMessages]) -> str:
    """All that was lost in one clause: how much of which topics, and when."""
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
    """The metadata that says in a recovered log what was lost, with its CRC."""
    said = {"lost": json.dumps([asdict(one) for one in lost])}
    return said | {"crc32": header_crc32(said)}


def losses_in(record: Mapping[str, str]) -> tuple[LostMessages, ...]:
    """What `loss_metadata` said, nothing for an empty record; ValueError or TypeError for any other."""
    if not record:
        return ()
    if record.get("crc32") != header_crc32({"lost": record.get("lost", "")}):
        raise ValueError("what the log says of a recovery does not match its CRC")
    return tuple(LostMessages(**one) for one in json.loads(record["lost"]))


class LogDamaged(LogCorrupt):  # says what is so
    """The bytes of a log are not those that were written; `lost` is what cannot be read for it."""

    def __init__(self, path: Path, why: str, offset: int, lost: Sequence[LostMessages]) -> None:
        super().__init__(path, f"{why}, {summarize_losses(lost)}", offset)
        self.lost = tuple(lost)

"""Conventions of a log beyond MCAP and CDR: version, names of records, keys and topics, length of a cycle.

Errors of logs, and the messages that a damaged log has lost, as records, text and metadata.
"""

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from mcap.records import Metadata

from simgap.common.errors import UserError

TICK_NS: Final = 15_625_000
"""Length of a cycle at 64 Hz, exact."""

CHUNK_CYCLES: Final = 64
"""Cycles in a chunk: a second of Mars time, which is what a killed run loses at most."""

SAMPLE_CYCLES: Final = 16
"""Cycles between two samples of a page: at 4 Hz no joint turns by more than 2 degrees between two."""

FORMAT: Final = "2"
"""Version of the format; a reader refuses others."""

FORMAT_RECORD: Final = "marsarm.format"
HEADER_RECORD: Final = "marsarm.header"
END_RECORD: Final = "marsarm.end"
"""Metadata at the end of the log of an interrupted run; other logs have none."""
INTERRUPTED_KEY: Final = "interrupted_by"
CRC_KEY: Final = "crc32"
WRITER_KEY: Final = "marsarm"
"""Key of the header: version of the marsarm that wrote the log."""
CHANNELS_KEY: Final = "channels"
"""Key of the header: every channel by topic, so that a reader needs no schema or channel record."""

LAYOUT_KEY: Final = "layout"
TRUTH_KEY: Final = "truth"
TRUTH_TEXT: Final = "the plant's own state; flight software never sees it"
EVR_TOPIC: Final = "/evr"
COMMAND_TOPIC: Final = "/command"
SENSOR_TOPIC: Final = "/sensors"
DRIVE_TOPIC: Final = "/drive"


def version_problem(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return why a log with these metadata records is not read; empty if it is of a known version."""
    form = metadata.get(FORMAT_RECORD, {"version": FORMAT}).get("version")
    if form != FORMAT:
        return f"log format {form}; this marsarm reads format {FORMAT}"
    return ""


def with_crc(record: Mapping[str, str]) -> dict[str, str]:
    """Return a metadata record with a CRC."""
    return {**record, CRC_KEY: header_crc32(record)}


def without_crc(record: Mapping[str, str]) -> dict[str, str]:
    """Return what `with_crc` was given, or nothing if there is no record; ValueError if it is damaged."""
    plain = {key: value for key, value in record.items() if key != CRC_KEY}
    if record and record.get(CRC_KEY) != header_crc32(plain):
        raise ValueError("what the log says of its end or of a recovery does not match its CRC")
    return plain


def end_metadata(interrupted_by: str) -> list[Metadata]:
    """Return the metadata for the end of a log; none if `interrupted_by` is empty."""
    return [Metadata(END_RECORD, with_crc({INTERRUPTED_KEY: interrupted_by}))] if interrupted_by else []


def header_records(header: Mapping[str, str]) -> list[Metadata]:
    """Return the format and the header, which begin a log."""
    about = {"version": FORMAT, "header_crc32": header_crc32(header)}
    return [Metadata(FORMAT_RECORD, about), Metadata(HEADER_RECORD, dict(header))]


def header_crc32(header: Mapping[str, str]) -> str:
    """Compute the CRC of a header; MCAP has none for metadata in a truncated file."""
    return str(zlib.crc32(json.dumps(dict(header), sort_keys=True).encode()))


RECOVERED_RECORD: Final = "marsarm.recovered"
"""Name of the metadata that lists what a recovered log has lost."""


class LogError(UserError):
    """Error of a log; `path` is the file and `why` the reason."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"log {path}: {why}")
        self.path = path
        self.why = why


class LogNotWritable(LogError):
    """Error of a path where no log can be written; nothing was written."""


class LogNotReadable(LogError):
    """Error of a file that is not a marsarm log, or has a format that this version does not know."""


class LogDamaged(LogError):
    """Error of a log whose bytes changed after it was written; `offset` is the byte where this shows."""

    def __init__(self, path: Path, why: str, offset: int) -> None:
        super().__init__(
            path,
            f"{why} (byte {offset}); the file was changed after it was written, and `marsarm log recover` "
            "copies what is readable and says what is lost",
        )
        self.offset = offset


class SchemaError(Exception):
    """Error of a packet, command or EVR with a value that the format of a log cannot hold."""


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
        when = span_text(self.after_ns, self.before_ns)
        return f"{count} {messages} of {self.topic or 'all topics'} lost, {when}"


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


def loss_metadata(lost: Sequence[LostMessages]) -> Metadata:
    """Return the metadata that lists the losses in a recovered log."""
    return Metadata(RECOVERED_RECORD, with_crc({"lost": json.dumps([asdict(one) for one in lost])}))


def losses_in(record: Mapping[str, str]) -> tuple[LostMessages, ...]:
    """Read the metadata that `loss_metadata` made; ValueError or TypeError if it is damaged."""
    return tuple(LostMessages(**one) for one in json.loads(without_crc(record).get("lost", "[]")))

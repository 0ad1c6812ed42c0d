"""Conventions of a log beyond MCAP and CDR: version, names of records, keys and topics, length of a cycle."""

import json
import zlib
from collections.abc import Mapping
from typing import Final

from mcap.records import Metadata

TICK_NS: Final = 15_625_000
"""Length of a cycle at 64 Hz, exact."""

CHUNK_CYCLES: Final = 64
"""Cycles in a chunk: a second of Mars time, which is what a killed run loses at most."""

FORMAT: Final = "2"
"""Version of the format; a reader refuses others."""
UNREADABLE_VERSIONS: Final = ("0.1.", "0.2.")
"""Versions of marsarm whose logs have the same format, but other names; a reader refuses them."""

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
DERIVED_KEY: Final = "derived"
"""Key of the metadata of a channel that was computed from other channels, for other tools."""
EVR_TOPIC: Final = "/evr"
COMMAND_TOPIC: Final = "/command"
SENSOR_TOPIC: Final = "/sensors"


def version_problem(metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Return why a log with these metadata records is not read; empty if it is of a known version."""
    form = metadata.get(FORMAT_RECORD, {"version": FORMAT}).get("version")
    if form != FORMAT:
        return f"log format {form}; this marsarm reads format {FORMAT}"
    writer = metadata.get(HEADER_RECORD, {}).get(WRITER_KEY, "")
    if writer.startswith(UNREADABLE_VERSIONS):
        return f"a log of marsarm {writer[:3]}, which reads it; this marsarm reads logs of 0.3 and later"
    return ""


def end_metadata(interrupted_by: str) -> list[Metadata]:
    """Return the metadata for the end of a log, with a CRC; none if `interrupted_by` is empty."""
    record = {INTERRUPTED_KEY: interrupted_by}
    return [Metadata(END_RECORD, record | {CRC_KEY: header_crc32(record)})] if interrupted_by else []


def interruption_in(record: Mapping[str, str]) -> str:
    """Read the metadata that `end_metadata` made: the cause; empty if the record is empty.

    Raises:
        ValueError: the record is damaged.
    """
    if not record:
        return ""
    cause = record.get(INTERRUPTED_KEY, "")
    if record.get(CRC_KEY) != header_crc32({INTERRUPTED_KEY: cause}):
        raise ValueError("what the log says of its end does not match its CRC")
    return cause


def header_records(header: Mapping[str, str]) -> list[Metadata]:
    """Return the format and the header, which begin a log."""
    about = {"version": FORMAT, "header_crc32": header_crc32(header)}
    return [Metadata(FORMAT_RECORD, about), Metadata(HEADER_RECORD, dict(header))]


def header_crc32(header: Mapping[str, str]) -> str:
    """Compute the CRC of a header; MCAP has none for metadata in a truncated file."""
    return str(zlib.crc32(json.dumps(dict(header), sort_keys=True).encode()))

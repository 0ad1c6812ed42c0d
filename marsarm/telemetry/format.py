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

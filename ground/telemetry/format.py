"""Conventions of a log beyond MCAP and CDR: version, names of records, keys and topics, length of a cycle."""

import json
import zlib
from collections.abc import Mapping
from typing import Final

TICK_NS: Final = 15_625_000
"""Length of a cycle at 64 Hz, exact."""

CHUNK_S: Final = 0.005
"""Wall time after which a chunk is closed. A killed run loses this time plus the time to write a chunk."""

FORMAT: Final = "2"
"""Version of the format; a reader refuses others."""

FORMAT_RECORD: Final = "marsarm.format"
HEADER_RECORD: Final = "marsarm.header"
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


def header_crc32(header: Mapping[str, str]) -> str:
    """Compute the CRC of a header; MCAP has none for metadata in a truncated file."""
    return str(zlib.crc32(json.dumps(dict(header), sort_keys=True).encode()))

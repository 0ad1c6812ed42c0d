"""What the writer and the reader of a log agree on beyond MCAP and CDR."""

import json
import zlib
from collections.abc import Mapping
from typing import Final

TICK_NS: Final = 15_625_000
"""One cycle at 64 Hz; exact."""

CHUNK_S: Final = 0.005
"""Wall time after which a chunk is closed; with the time that this takes, what a kill can cost."""

FORMAT: Final = "2"
"""Version of what a log holds; a reader refuses one that it does not know."""

FORMAT_RECORD: Final = "marsarm.format"
HEADER_RECORD: Final = "marsarm.header"
CHANNELS_KEY: Final = "channels"
"""Of the header: what every channel is, by topic, so that a reader needs no schema or channel record."""

LAYOUT_KEY: Final = "layout"
TRUTH_KEY: Final = "truth"
TRUTH_TEXT: Final = "the plant's own state; flight software never sees it"
DERIVED_KEY: Final = "derived"
"""Of a channel's metadata: it was computed from other channels, for the tools of others."""
EVR_TOPIC: Final = "/evr"
COMMAND_TOPIC: Final = "/command"


def header_crc32(header: Mapping[str, str]) -> str:
    """The check of a header; MCAP has none for metadata in a file cut short."""
    return str(zlib.crc32(json.dumps(dict(header), sort_keys=True).encode()))

"""What the writer and the reader of a log agree on beyond MCAP and CDR."""

import json
import zlib
from collections.abc import Mapping
from typing import Final

TICK_NS: Final = 15_625_000
"""One cycle at 64 Hz; exact."""

CHUNK_S: Final = 0.010
"""Wall time after which a chunk is closed: what a kill can cost."""

FORMAT: Final = "1"
"""Version of what a log holds; a reader refuses one that it does not know."""

FORMAT_RECORD: Final = "marsarm.format"
HEADER_RECORD: Final = "marsarm.header"
LAYOUT_KEY: Final = "layout"
TRUTH_KEY: Final = "truth"
EVR_TOPIC: Final = "/evr"
COMMAND_TOPIC: Final = "/command"


def header_crc32(header: Mapping[str, str]) -> str:
    """The check of a header; MCAP has none for metadata in a file cut short."""
    return str(zlib.crc32(json.dumps(dict(header), sort_keys=True).encode()))

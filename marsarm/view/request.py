"""Request of `marsarm view`: its options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from simgap.common.options import Option

DEFAULT_PORT: Final = 8080


@dataclass(frozen=True, slots=True)
class ViewRequest:
    """Options of `marsarm view`."""

    log: Annotated[Path, Option("A telemetry log (MCAP).", "LOG", is_argument=True, is_read=True)]
    html: Annotated[
        Path | None,
        Option(
            "Write one page that plays without a server, and serve nothing.", "FILE.html", suffixes=(".html",)
        ),
    ] = None
    port: Annotated[
        int,
        Option(
            "Port of the viewer on 127.0.0.1; the next free one if it is taken.", "PORT", within=(1024, 65535)
        ),
    ] = DEFAULT_PORT

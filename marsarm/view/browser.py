"""Opening of a page in the browser of this machine."""

import os
import sys
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Final

OWN_SCREEN: Final = ("darwin", "win32")
"""Platforms on which a browser needs no variable to find the screen."""


@dataclass(frozen=True, slots=True)
class OpenedPage:
    """Page that is opened when it is played."""

    path: Path

    def play(self) -> None:
        """Open the page in the browser, or say where it is if there is no display or no browser."""
        has_display = sys.platform in OWN_SCREEN or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
        is_open = has_display and webbrowser.open(self.path.resolve().as_uri())
        what = "opened in the browser" if is_open else "there is no display here; open it in any browser"
        print(f"{self.path}: {what}", file=sys.stderr)

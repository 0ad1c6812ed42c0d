"""Exceptions in an effect that a user wrote: one sentence with file and line, not a traceback."""

import re
import sys
import traceback
from typing import Final

FRAME_PATTERN: Final = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>[0-9]+)')
"""Line of a traceback as text, which is all that a worker process sends."""


def describe_failed_effect(error: Exception) -> str | None:
    """Describe an exception that passed through the file of a user's effect; None for any other exception."""
    modules = (sys.modules.get(name) for name in ("sim.scenario.effects", "simgap.catalogue.own_effects"))
    files = set().union(*(module.user_files() for module in modules if module is not None))
    if not files:
        return None
    lines = "".join(traceback.format_exception(error))
    places = [found for found in FRAME_PATTERN.finditer(lines) if found["file"] in files]
    if not places:
        return None
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return f"effect {places[-1]['file']}:{places[-1]['line']}: {what}; mend the effect, or leave it out"

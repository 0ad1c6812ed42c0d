"""Origin of a result: its date, and the revision of the source tree."""

import os
import subprocess
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Final

from simgap.common.errors import BadRequest

DATE_VARIABLE: Final = "SOURCE_DATE_EPOCH"
"""Environment variable with a date in seconds since 1970, which other software honours too."""


def current_date() -> datetime:
    """Return the date of the environment variable, or else the present; BadRequest if it is no date."""
    text = os.environ.get(DATE_VARIABLE)
    try:
        return datetime.now(UTC) if text is None else datetime.fromtimestamp(int(text), UTC)
    except (ValueError, OverflowError, OSError):
        raise BadRequest(
            f"{DATE_VARIABLE}: {text!r} is not a date; give whole seconds since 1970, or unset it"
        ) from None


REPOSITORY: Final = Path(__file__).resolve().parents[4]
GIT_TIMEOUT_S: Final = 5.0


@cache
def git_revision() -> str:
    """Return the commit of this tree, with "-dirty" if files are changed; "unknown" outside of git."""
    if not (REPOSITORY / ".git").exists():
        return "unknown"
    command = ["git", "-C", str(REPOSITORY), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()

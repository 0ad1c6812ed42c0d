"""Date of what is computed."""

import os
from datetime import UTC, datetime
from typing import Final

from simgap.common.errors import BadRequest

DATE_VARIABLE: Final = "SOURCE_DATE_EPOCH"
"""Environment variable with a date in seconds since 1970, which other software honours too."""


def current_date() -> datetime:
    """Return the date of the environment variable, or else the present.

    Raises:
        BadRequest: the variable is no date.
    """
    text = os.environ.get(DATE_VARIABLE)
    try:
        return datetime.now(UTC) if text is None else datetime.fromtimestamp(int(text), UTC)
    except (ValueError, OverflowError, OSError):
        raise BadRequest(
            f"{DATE_VARIABLE}: {text!r} is not a date; give whole seconds since 1970, or unset it"
        ) from None

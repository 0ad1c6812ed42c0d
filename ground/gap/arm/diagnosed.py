"""Logs diagnosed: from a request to all that is said of them."""

from ground.gap.arm.logs import NotForDiagnosis
from ground.gap.arm.request import DiagnoseRequest
from ground.gap.result import Result
from ground.progress import Progress


def diagnosed(request: DiagnoseRequest, progress: Progress) -> Result:
    """What the logs say.

    Raises:
        NotForDiagnosis: they cannot be diagnosed; the message says what they lack.
    """
    raise NotForDiagnosis("diagnose: is not there yet")

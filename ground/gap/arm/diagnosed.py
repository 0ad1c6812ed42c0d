"""Logs diagnosed: from a request to all that is said of them."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from fsw.dictionary.params import Params
from ground.gap.arm.audit import refusals
from ground.gap.arm.case import solved
from ground.gap.arm.logs import NotForDiagnosis, Recording, recording_in
from ground.gap.arm.reference import reference
from ground.gap.arm.request import DiagnoseRequest
from ground.gap.result import Result
from ground.pool import on_this_machine
from ground.progress import Progress
from sim.params import nominal_params, params_over_nominal

CACHE: Final = Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")) / "marsarm" / "sensitivities"


def diagnosed(request: DiagnoseRequest, progress: Progress) -> Result:
    """What the logs say.

    Raises:
        NotForDiagnosis: they cannot be diagnosed; the message says what they lack.
    """
    base = nominal_params() if request.params is None else params_over_nominal(request.params)
    fitted, apart = (_read(paths, base) for paths in (request.logs, request.held_out))
    logs, held_out = request.logs, request.held_out
    if request.campaign is not None:
        logs, held_out = (_of_campaign(request.campaign, of) for of in (fitted, apart))
    against = reference(
        logs,
        held_out,
        request.campaign or CACHE.expanduser(),
        on_this_machine(os.cpu_count() or 1),
        progress,
        request.kinds,
    )
    return solved(fitted, apart, against, base, request.seed, request.patch)


def _read(paths: Sequence[Path], base: Params) -> list[Recording]:
    """Recordings that may be believed."""
    recordings = [recording_in(path) for path in paths]
    wrong = refusals(recordings, base)
    if wrong:
        raise NotForDiagnosis("\n".join(wrong))
    return recordings


def _of_campaign(folder: Path, recordings: Sequence[Recording]) -> tuple[Path, ...]:
    """Logs of the sessions that these recordings repeat."""
    paths = tuple(folder / f"{one.name}.mcap" for one in recordings)
    missing = [path.stem for path in paths if not path.is_file()]
    if missing:
        raise NotForDiagnosis(f"campaign {folder}: has no session {', '.join(missing)}")
    return paths

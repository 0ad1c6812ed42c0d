"""Logs diagnosed: from a request to all that is said of them."""

import os
from collections.abc import Sequence
from pathlib import Path

from ground.common.pool import local_runner
from ground.common.progress import Progress
from ground.diagnosis.arm.audit import believed, too_little
from ground.diagnosis.arm.case import solved
from ground.diagnosis.arm.logs import NotForDiagnosis, Recording
from ground.diagnosis.arm.recorded import APART
from ground.diagnosis.arm.reference import reference
from ground.diagnosis.arm.request import DiagnoseRequest
from ground.diagnosis.arm.sensitivities import Logs
from ground.diagnosis.result import Result


def diagnosed(request: DiagnoseRequest, progress: Progress) -> Result:
    """What the logs say.

    Raises:
        NotForDiagnosis: they cannot be diagnosed; the message says what they lack.
        BadRequest: what is kept of the campaign cannot be read.
        BadOutput: it cannot be written.
    """
    base = request.base
    fitted, apart = (believed(paths, base) for paths in (request.logs, request.held_out))
    _check_sessions((*request.logs, *request.held_out), (*fitted, *apart))
    _check_apart(fitted, apart)
    _check_motion(fitted)
    logs, held_out = request.logs, request.held_out
    if request.campaign is not None:
        logs, held_out = _of_campaign(request.campaign, fitted, apart)
    against = reference(
        logs,
        held_out,
        request.campaign or _cache(),
        local_runner(os.cpu_count() or 1),
        progress,
        request.kinds,
    )
    return solved(fitted, apart, against, request.seed, request.patch)


def _cache() -> Path:
    """Of the user, as the XDG base directory specification has it: an empty variable is none."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return base / "marsarm" / "sensitivities"


def _check_motion(recordings: Sequence[Recording]) -> None:
    """Before anything is computed that takes minutes."""
    missing = too_little(recordings)
    if missing:
        raise NotForDiagnosis("\n".join(("too little motion for a diagnosis:", *missing)))


def _check_sessions(paths: Sequence[Path], recordings: Sequence[Recording]) -> None:
    """Features are known by their session's name."""
    known: dict[str, Path] = {}
    for path, one in zip(paths, recordings, strict=True):
        if known.setdefault(one.name, path) is not path:
            raise NotForDiagnosis(
                f"log {path}: is session {one.name}, and so is {known[one.name]}; leave one of them out"
            )


def _check_apart(fitted: Sequence[Recording], held_out: Sequence[Recording]) -> None:
    """A repeat of a motion that is fitted is not held out."""
    used = {one.block: one.name for one in fitted}
    both = [one for one in held_out if one.block in used]
    if both:
        raise NotForDiagnosis(
            f"held-out session {both[0].name} repeats the motion of {used[both[0].block]}, which is not "
            f"held out; hold out both, or neither"
        )


def _of_campaign(
    folder: Path, fitted: Sequence[Recording], held_out: Sequence[Recording]
) -> tuple[Logs, Logs]:
    """All of a campaign's logs, divided as these are: a session that is not here is on the side it has there.

    So what is kept of the campaign serves for a part of it, too; what is missing is told.
    """
    inside = {path.stem: path for path in folder.glob("*.mcap")}
    outside = {path.stem: path for path in (folder / APART).glob("*.mcap")}
    known = inside | outside
    sides = [{one.name for one in side} for side in (fitted, held_out)]
    missing = sorted((sides[0] | sides[1]) - known.keys())
    if missing:
        raise NotForDiagnosis(f"campaign {folder}: has no session {', '.join(missing)}")
    apart = (outside.keys() - sides[0]) | sides[1]
    logs = tuple(known[name] for name in sorted(known.keys() - apart))
    return logs, tuple(known[name] for name in sorted(apart)) if held_out else ()

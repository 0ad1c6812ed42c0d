"""What is known of a campaign before a case: sensitivities, keys of the features, thresholds; all kept."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter, ValidationError

import ground.diagnosis
from ground.common.files import atomic_write
from ground.common.pool import Runner
from ground.common.progress import Progress
from ground.common.requests import BadRequest
from ground.diagnosis.arm.sensitivities import arm_sensitivities
from ground.diagnosis.ready import Ready, ready
from ground.diagnosis.sensitivity import Sensitivities
from ground.diagnosis.thresholds import Thresholds
from ground.diagnosis.trust import Signs

SEED: Final = 0
"""Of the cases that thresholds are calibrated with."""
_KEPT: Final = TypeAdapter(Thresholds)


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A campaign that cases repeat."""

    ready: Ready
    """Of the motions that are fitted."""
    keys: tuple[str, ...]
    """Of their features."""
    held_out: Sensitivities | None
    """Of the motions that are held out."""
    held_out_keys: tuple[str, ...]


def reference(
    logs: Sequence[Path],
    held_out: Sequence[Path],
    kept_in: Path,
    run: Runner,
    progress: Progress,
    kinds: Sequence[str] | None = None,
) -> Reference:
    """Of these logs; what is not kept yet is computed, in minutes.

    Raises:
        BadRequest: what is kept cannot be read.
        BadOutput: a file cannot be written.
    """
    fitted = arm_sensitivities(logs, kept_in, run, progress, kinds)
    thresholds = fitted.path.with_suffix(".thresholds.json")
    known = thresholds_in(thresholds) if thresholds.exists() else None
    made = ready(fitted.found, SEED, thresholds=known, step=lambda k, n: progress(k, n, "thresholds"))
    if known is None:
        save_thresholds(made.thresholds, thresholds)
    keys = fitted.keys()
    if not held_out:
        return Reference(made, keys, None, ())
    apart = arm_sensitivities(held_out, kept_in, run, progress, kinds)
    return Reference(made, keys, apart.found, apart.keys())


def save_thresholds(found: Thresholds, path: Path) -> None:
    """Keep them with a digest of the code that found them; BadOutput if they cannot be written."""
    with atomic_write(path, "thresholds") as file:
        file.write(json.dumps({"code": _code(), **asdict(found)}).encode())


def thresholds_in(path: Path) -> Thresholds | None:
    """As they were kept, None if other code found them; BadRequest if they cannot be read."""
    try:
        said = json.loads(path.read_bytes())
        if said.pop("code", None) != _code():
            return None
        found = _KEPT.validate_python(said)
        if len(found.trust.weights) != len(fields(Signs)) + 1:
            raise ValueError(f"{len(found.trust.weights)} weights")
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise BadRequest(f"{path}: no thresholds ({why}); remove it, and they are found anew") from error
    return found


@cache
def _code() -> str:
    """SHA-256 of what draws, races and judges the simulated cases."""
    total = hashlib.sha256()
    for source in sorted(Path(ground.diagnosis.__path__[0]).glob("*.py")):
        total.update(source.read_bytes())
    return total.hexdigest()

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
from ground.diagnosis.arm.campaign_sensitivities import compute_sensitivities
from ground.diagnosis.confidence import ConfidenceFeatures
from ground.diagnosis.model import DiagnosisModel, build_model
from ground.diagnosis.sensitivity import Sensitivities
from ground.diagnosis.thresholds import Thresholds

CALIBRATION_SEED: Final = 0
"""Of the cases that thresholds are calibrated with."""
_THRESHOLDS_ADAPTER: Final = TypeAdapter(Thresholds)


@dataclass(frozen=True, slots=True, eq=False)
class CampaignModel:
    """A campaign that cases repeat."""

    model: DiagnosisModel
    """Of the motions that are fitted."""
    keys: tuple[str, ...]
    """Of their features."""
    held_out: Sensitivities | None
    """Of the motions that are held out."""
    held_out_keys: tuple[str, ...]


def load_campaign_model(
    logs: Sequence[Path],
    held_out: Sequence[Path],
    kept_in: Path,
    run: Runner,
    progress: Progress,
    kinds: Sequence[str] | None = None,
) -> CampaignModel:
    """Of these logs; what is not kept yet is computed, in minutes.

    Raises:
        BadRequest: what is kept cannot be read.
        BadOutput: a file cannot be written.
    """
    fitted = compute_sensitivities(logs, kept_in, run, progress, kinds)
    thresholds = fitted.path.with_suffix(".thresholds.json")
    known = load_thresholds(thresholds) if thresholds.exists() else None
    made = build_model(
        fitted.sensitivities,
        CALIBRATION_SEED,
        thresholds=known,
        step=lambda k, n: progress(k, n, "thresholds"),
    )
    if known is None:
        save_thresholds(made.thresholds, thresholds)
    keys = fitted.keys()
    if not held_out:
        return CampaignModel(made, keys, None, ())
    apart = compute_sensitivities(held_out, kept_in, run, progress, kinds)
    return CampaignModel(made, keys, apart.sensitivities, apart.keys())


def save_thresholds(found: Thresholds, path: Path) -> None:
    """Keep them with a digest of the code that found them; BadOutput if they cannot be written."""
    with atomic_write(path, "thresholds") as file:
        file.write(json.dumps({"code": _code_digest(), **asdict(found)}).encode())


def load_thresholds(path: Path) -> Thresholds | None:
    """As they were kept, None if other code found them; BadRequest if they cannot be read."""
    try:
        said = json.loads(path.read_bytes())
        if said.pop("code", None) != _code_digest():
            return None
        found = _THRESHOLDS_ADAPTER.validate_python(said)
        if len(found.trust.weights) != len(fields(ConfidenceFeatures)) + 1:
            raise ValueError(f"{len(found.trust.weights)} weights")
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise BadRequest(f"{path}: no thresholds ({why}); remove it, and they are found anew") from error
    return found


@cache
def _code_digest() -> str:
    """SHA-256 of what draws, races and judges the simulated cases."""
    total = hashlib.sha256()
    for source in sorted(Path(ground.diagnosis.__path__[0]).glob("*.py")):
        total.update(source.read_bytes())
    return total.hexdigest()

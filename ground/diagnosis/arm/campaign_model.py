"""Campaign model: sensitivities, feature keys and thresholds, computed before a case and cached."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter, ValidationError

import ground.diagnosis
from ground.common.errors import BadRequest
from ground.common.files import atomic_write
from ground.common.pool import Runner
from ground.common.progress import Progress, part_of
from ground.diagnosis.arm.campaign_sensitivities import compute_sensitivities
from ground.diagnosis.confidence import ConfidenceFeatures
from ground.diagnosis.model import DiagnosisModel, build_model
from ground.diagnosis.sensitivity import Sensitivities
from ground.diagnosis.thresholds import Thresholds

CALIBRATION_SEED: Final = 0
"""Seed of the simulated cases that calibrate the thresholds."""
SENSITIVITY_SHARE: Final = 0.9
"""Share of the sensitivities in the time of a campaign model, for the progress; the rest finds thresholds."""
_THRESHOLDS_ADAPTER: Final = TypeAdapter(Thresholds)


@dataclass(frozen=True, slots=True, eq=False)
class CampaignModel:
    """Campaign whose motions a case repeats."""

    model: DiagnosisModel
    """Diagnosis model of the fitted motions."""
    keys: tuple[str, ...]
    """Keys of their features."""
    held_out: Sensitivities | None
    """Sensitivities of the held-out motions, if there are any."""
    held_out_keys: tuple[str, ...]


def load_campaign_model(
    logs: Sequence[Path],
    held_out: Sequence[Path],
    kept_in: Path,
    run: Runner,
    progress: Progress,
    kinds: Sequence[str] | None = None,
) -> CampaignModel:
    """Load the campaign model of these logs; compute in minutes what is not cached.

    Args:
        logs: Logs of the fitted motions.
        held_out: Logs of the held-out motions.
        kept_in: Cache folder.
        run: Runner of parallel jobs.
        progress: Called with done, total and step.
        kinds: Names of the effects of the catalogue; None for all.

    Raises:
        BadRequest: A cached file cannot be read.
        BadOutput: A file cannot be written.
    """
    share = SENSITIVITY_SHARE * len(logs) / (len(logs) + len(held_out))
    fitted = compute_sensitivities(logs, kept_in, run, part_of(progress, 0.0, share), kinds)
    of_thresholds = part_of(progress, share, share + 1.0 - SENSITIVITY_SHARE)
    thresholds = fitted.path.with_suffix(".thresholds.json")
    known = load_thresholds(thresholds) if thresholds.exists() else None
    made = build_model(
        fitted.sensitivities,
        CALIBRATION_SEED,
        thresholds=known,
        step=lambda k, n: of_thresholds(k, n, "thresholds"),
    )
    if known is None:
        save_thresholds(made.thresholds, thresholds)
    keys = fitted.keys()
    if not held_out:
        return CampaignModel(made, keys, None, ())
    rest = part_of(progress, share + 1.0 - SENSITIVITY_SHARE, 1.0)
    held_out_sensitivities = compute_sensitivities(held_out, kept_in, run, rest, kinds)
    return CampaignModel(made, keys, held_out_sensitivities.sensitivities, held_out_sensitivities.keys())


def save_thresholds(found: Thresholds, path: Path) -> None:
    """Save thresholds with a digest of the code that found them; BadOutput if they cannot be written."""
    with atomic_write(path, "thresholds") as file:
        file.write(json.dumps({"code": _code_digest(), **asdict(found)}).encode())


def load_thresholds(path: Path) -> Thresholds | None:
    """Load thresholds; None if other code found them, BadRequest if they cannot be read."""
    try:
        document = json.loads(path.read_bytes())
        if document.pop("code", None) != _code_digest():
            return None
        found = _THRESHOLDS_ADAPTER.validate_python(document)
        if len(found.confidence.weights) != len(fields(ConfidenceFeatures)) + 1:
            raise ValueError(f"{len(found.confidence.weights)} weights")
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise BadRequest(f"{path}: no thresholds ({why}); remove it, and they are found anew") from error
    return found


@cache
def _code_digest() -> str:
    """Return the SHA-256 of the code that simulates, selects and decides."""
    total = hashlib.sha256()
    for source in sorted(Path(ground.diagnosis.__path__[0]).glob("*.py")):
        total.update(source.read_bytes())
    return total.hexdigest()

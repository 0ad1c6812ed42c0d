"""Campaign model: sensitivities and feature keys, computed before a case and cached."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from marsarm.common.pool import Runner
from marsarm.diagnosis.arm.campaign_sensitivities import compute_sensitivities
from marsarm.diagnosis.arm.families import list_families, list_locations
from marsarm.diagnosis.model import DiagnosisModel, build_model
from marsarm.diagnosis.sensitivity import Sensitivities
from simgap.common.progress import Progress, part_of


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
    share = len(logs) / (len(logs) + len(held_out))
    fitted = compute_sensitivities(logs, kept_in, run, part_of(progress, 0.0, share), kinds)
    known = fitted.sensitivities.hypotheses
    made = build_model(fitted.sensitivities, list_families(known), list_locations(known))
    keys = fitted.keys()
    if not held_out:
        return CampaignModel(made, keys, None, ())
    rest = part_of(progress, share, 1.0)
    held_out_sensitivities = compute_sensitivities(held_out, kept_in, run, rest, kinds, steps_of=logs)
    return CampaignModel(made, keys, held_out_sensitivities.sensitivities, held_out_sensitivities.keys())

"""What is known of a campaign before a case: sensitivities, keys of the features, thresholds; all kept."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ground.gap.arm.sensitivities import arm_sensitivities, kept_path, keys_path
from ground.gap.ready import Ready, ready
from ground.gap.sensitivity import Sensitivities
from ground.gap.thresholds import Thresholds
from ground.gap.trust import Trust
from ground.pool import Runner
from ground.progress import Progress

SEED = 0
"""Of the cases that thresholds are calibrated with."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A campaign that cases repeat."""

    ready: Ready
    """Of the motions that are fitted."""
    keys: tuple[str, ...]
    """Of their features."""
    held_out: Sensitivities | None
    """Of the nuisances alone, in the motions that are held out."""
    held_out_keys: tuple[str, ...]


def reference(
    logs: Sequence[Path],
    held_out: Sequence[Path],
    kept_in: Path,
    run: Runner,
    progress: Progress,
    kinds: Sequence[str] | None = None,
) -> Reference:
    """Of these logs; what is not kept yet is computed, in minutes."""
    found = arm_sensitivities(logs, kept_in, run, progress, kinds)
    path = kept_path(logs, kept_in, kinds)
    thresholds = path.with_suffix(".thresholds.json")
    known = thresholds_in(thresholds) if thresholds.exists() else None
    made = ready(found, SEED, thresholds=known, step=lambda k, n: progress(k, n, "thresholds"))
    if known is None:
        thresholds.write_text(json.dumps(asdict(made.thresholds)), encoding="utf-8")
    if not held_out:
        return Reference(made, _keys(path), None, ())
    apart = arm_sensitivities(held_out, kept_in, run, progress, ())
    return Reference(made, _keys(path), apart, _keys(kept_path(held_out, kept_in, ())))


def thresholds_in(path: Path) -> Thresholds:
    """As they were kept."""
    said = json.loads(path.read_text(encoding="utf-8"))
    trust = Trust(tuple(said["trust"]["weights"]), said["trust"]["least"])
    return Thresholds(**{**said, "trust": trust})


def _keys(path: Path) -> tuple[str, ...]:
    return tuple(json.loads(keys_path(path).read_text(encoding="utf-8")))

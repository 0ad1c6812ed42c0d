"""What is known of a campaign before a case: sensitivities, keys of the features, thresholds; all kept."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ground.gap.arm.sensitivities import arm_sensitivities
from ground.gap.ready import Ready, ready
from ground.gap.sensitivity import Sensitivities
from ground.gap.thresholds import Thresholds
from ground.gap.trust import Trust
from ground.outputs import written_whole
from ground.pool import Runner
from ground.progress import Progress
from ground.request import BadRequest

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
        with written_whole(thresholds, "thresholds") as file:
            file.write(json.dumps(asdict(made.thresholds)).encode())
    keys = fitted.keys()
    if not held_out:
        return Reference(made, keys, None, ())
    apart = arm_sensitivities(held_out, kept_in, run, progress, ())
    return Reference(made, keys, apart.found, apart.keys())


def thresholds_in(path: Path) -> Thresholds:
    """As they were kept; BadRequest if they cannot be read."""
    try:
        said = json.loads(path.read_bytes())
        trust = Trust(tuple(said["trust"]["weights"]), said["trust"]["least"])
        return Thresholds(**{**said, "trust": trust})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadRequest(f"{path}: no thresholds ({error}); remove it, and they are found anew") from error

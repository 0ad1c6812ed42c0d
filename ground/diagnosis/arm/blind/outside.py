"""Effects that no catalogue has, from a folder of Python files, and how large each must be to be seen."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.common.checkpoint import Checkpoint
from ground.common.pool import Runner
from ground.common.progress import Progress
from ground.common.requests import BadRequest
from ground.diagnosis.arm.audit import believed
from ground.diagnosis.arm.blind.stepped import change
from ground.diagnosis.arm.campaign import Compared, compared
from ground.diagnosis.arm.simulator import BRIEFLY, switched_on, told
from ground.diagnosis.arm.step import ROUNDS, mended, off
from ground.diagnosis.detect import limit_beside, noncentrality
from ground.diagnosis.drawn import Seen
from ground.diagnosis.hypothesis import Hypothesis
from ground.diagnosis.plain import finite
from ground.diagnosis.prepared import Prepared
from sim.effects import catalogue
from sim.effects.effect import Effect
from sim.scenario.effects import BadEffect, effect_classes_in_file, effect_text, parse_effect_text

PLACES: Final = 2
"""Of each kind that are asked: limits of all would take as long as the cases."""
FOLDER: Final = Path(__file__).resolve().parents[4] / "validation" / "out_of_catalogue_effects"


@dataclass(frozen=True, slots=True, eq=False)
class Outside:
    """An effect of one size at a place."""

    hypothesis: Hypothesis
    made: catalogue.EffectHypothesis

    def spec(self, values: Array) -> str:
        """What switches it on, the file by its name in the folder."""
        text = effect_text(switched_on(self.made, self.hypothesis, values))
        return text.removeprefix(f"{FOLDER}/")


@dataclass(frozen=True, slots=True)
class _Job:
    logs: tuple[Path, ...]
    name: tuple[str, str]
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class _Sensed:
    name: tuple[str, str]
    share: float
    """Of a typical size, the step."""
    column: Array
    """Change of the features per typical size, upwards, (m,)."""


def all_outside() -> dict[tuple[str, str], Outside]:
    """Every one, by effect and place; BadRequest if there are no files of them."""
    files = sorted(FOLDER.glob("*.py"))
    if not files:
        raise BadRequest(f"{FOLDER}: holds no effects; cases are made in a clone of the repository")
    kinds = {kind.__name__: kind for file in files for kind in effect_classes_in_file(str(file))}
    found = (Outside(told(made), made) for made in catalogue.hypotheses(kinds))
    return {(one.hypothesis.effect, one.hypothesis.place): one for one in found}


def effect_in(spec: str) -> Effect:
    """The effect that a spec says, be it of the catalogue or of the folder."""
    try:
        return parse_effect_text(str(FOLDER / spec) if ".py:" in spec else spec)
    except BadEffect as error:
        raise BadRequest(str(error)) from error


def some_outside(rng: np.random.Generator) -> dict[tuple[str, str], Outside]:
    """Each kind at a few of its places."""
    known = all_outside()
    kinds = sorted({name for name, _ in known})
    found: dict[tuple[str, str], Outside] = {}
    for kind in kinds:
        places = sorted(place for name, place in known if name == kind)
        chosen = rng.choice(len(places), min(PLACES, len(places)), replace=False)
        found |= {(kind, places[k]): known[kind, places[k]] for k in chosen}
    return found


def limits(
    logs: Sequence[Path],
    prepared: Prepared,
    kept_in: Path,
    wanted: Mapping[tuple[str, str], Outside],
    run: Runner,
    progress: Progress,
) -> list[Seen]:
    """The detection limit of each, beside the nuisances, in a campaign's logs; kept as they are found.

    Raises:
        BadRequest: what is kept is of another campaign or other effects.
    """
    with Checkpoint(kept_in / "outside.jsonl", {"of": _digest(logs, prepared)}, _seen) as kept:
        there = {(one["name"], one["place"]): _seen(one) for one in kept.done}
        shares = {name: 1.0 for name in wanted if name not in there}
        best = dict.fromkeys(shares, np.inf)
        for attempt in range(ROUNDS + 1):
            jobs = [_Job(tuple(logs), name, share) for name, share in shares.items()]
            shares = {}
            for done, one in enumerate(run(_sensed, jobs), 1):
                limit = limit_beside(prepared, one.column[:, None])
                seen = one.share * float(np.sqrt(noncentrality(1))) / limit
                if off(seen) < best[one.name] or one.name not in there:
                    there[one.name], best[one.name] = limit, off(seen)
                better = mended(one.share, seen)
                if better is not None and attempt < ROUNDS:
                    shares[one.name] = better
                else:
                    kept.add({"name": one.name[0], "place": one.name[1], "limit": finite(there[one.name])})
                progress(done, len(jobs), "outside")
    return [Seen(one.hypothesis, there[name], None) for name, one in wanted.items()]


def _seen(said: dict[str, Any]) -> float:
    return float("inf") if said["limit"] is None else float(said["limit"])


def _sensed(job: _Job) -> _Sensed:
    return _Sensed(job.name, job.share, _change(_campaign(job.logs), job.name, job.share) / job.share)


def _change(campaign: Compared, name: tuple[str, str], share: float) -> Array:
    """By this share of its typical size, (m,)."""
    one = all_outside()[name]
    values = np.array([p.absent + share * p.typical * p.sizes for p in one.hypothesis.parameters])
    effect = switched_on(one.made, one.hypothesis, values)
    return change(campaign, (effect,), BRIEFLY)


@cache
def _campaign(logs: tuple[Path, ...]) -> Compared:
    return compared(believed(logs))


def _digest(logs: Sequence[Path], prepared: Prepared) -> str:
    """Of the campaign's logs, of the nuisances beside which effects are seen, and of the folder's files."""
    total = hashlib.sha256(prepared.A[:, : prepared.q].tobytes() + prepared.whiten.sigma.tobytes())
    for path in (*sorted(logs), *sorted(FOLDER.glob("*.py"))):
        total.update(path.read_bytes())
    return total.hexdigest()

"""Verdicts on blind cases against the truth, by equivalence class, every rate with its exact interval."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.binomial import Rate, rate
from ground.gap.diagnose import Diagnosis, Finding
from ground.gap.ready import Ready


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a case was made with."""

    hypotheses: tuple[int, ...]
    """Of the catalogue, by index; none if there was no effect or only one outside the catalogue."""
    values: tuple[Array, ...]
    """Of all parameters of each, in their units."""
    outside: bool
    """Whether an effect was there that is not in the catalogue."""
    times_limit: float
    """Size over the detection limit, of the least if there were several; 0 without effect."""


@dataclass(frozen=True, slots=True)
class Score:
    """Rates over cases; those of effects are of effects in the catalogue from the detection limit on."""

    false_alarm: Rate
    """No-effect cases called an effect, or unknown."""
    wrong_name: Rate
    """Cases of an effect outside the catalogue that were given a name (named or set)."""
    place: Rate
    """True effects of which a finding, or else the best-ranked hypothesis, has the place."""
    effect: Rate
    """... has the class."""
    in_set: Rate
    """True effects in the reported sets, by class."""
    covered: Rate
    """True values of fitted parameters within their 90 % intervals, where the very hypothesis was found."""
    set_size: float
    """Mean number of classes in a reported set; NaN if there is none."""


def score(ready: Ready, solved: Iterable[tuple[Truth, Diagnosis]]) -> Score:
    """Of all cases."""
    cases = tuple(solved)
    nothing = [said for true, said in cases if not true.hypotheses and not true.outside]
    strange = [said for true, said in cases if true.outside]
    clear = [
        (true, said)
        for true, said in cases
        if true.hypotheses and not true.outside and true.times_limit >= 1.0
    ]
    each = [(one, said) for true, said in clear for one in true.hypotheses]
    within = [inside for true, said in clear for inside in _within(true, said)]
    sets = [len(f.alternatives.hypotheses) for _, said in clear if _called(said) for f in said.findings]
    return Score(
        _rate(said.verdict != "none" for said in nothing),
        _rate(_called(said) for said in strange),
        _rate(_place(ready, one, said) for one, said in each),
        _rate(bool(_classes(ready, _first(said)) & {int(ready.label[one])}) for one, said in each),
        _rate(
            _called(said) and int(ready.label[one]) in _classes(ready, _reported(said)) for one, said in each
        ),
        _rate(within),
        float(np.mean(sets)) if sets else float("nan"),
    )


def _rate(hits: Iterable[bool]) -> Rate:
    told = list(hits)
    return rate(sum(told), len(told))


def _called(said: Diagnosis) -> bool:
    """Whether a name was given."""
    return said.verdict in ("named", "set")


def _first(said: Diagnosis) -> tuple[int, ...]:
    """First choices: the findings, or what would be if anything."""
    return tuple(finding.hypothesis for finding in said.findings) or said.ranking[:1]


def _reported(said: Diagnosis) -> tuple[int, ...]:
    """All that is in the sets."""
    return tuple(
        one for finding in said.findings for one in (finding.hypothesis, *finding.alternatives.hypotheses)
    )


def _classes(ready: Ready, hypotheses: tuple[int, ...]) -> set[int]:
    return {int(ready.label[one]) for one in hypotheses}


def _place(ready: Ready, one: int, said: Diagnosis) -> bool:
    """Whether a first choice, or what it cannot be told from, sits at the true place."""
    places = {
        ready.found.hypotheses[alike].place for first in _first(said) for alike in ready.confusable(first)
    }
    return ready.found.hypotheses[one].place in places


def _within(true: Truth, said: Diagnosis) -> list[bool]:
    """Of every fitted parameter of every true effect that was found."""
    found: dict[int, Finding] = {finding.hypothesis: finding for finding in said.findings}
    result = []
    for one, values in zip(true.hypotheses, true.values, strict=True):
        if one in found and _called(said):
            told = np.isfinite(found[one].least)
            result += [bool(x) for x in ((found[one].least <= values) & (values <= found[one].most))[told]]
    return result

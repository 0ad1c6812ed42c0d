"""What was said of blind cases against the truth, by class; every rate with its exact 95 % interval."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import binom

from ground.common.rates import Rate, estimate_rate
from ground.diagnosis.blind.classes import Classes
from ground.diagnosis.blind.truth import TrueCase, TrueEffect

BINS: Final = ((0.5, 1.0), (1.0, 1.5), (1.5, 2.0), (2.0, 4.0))
"""Of sizes over the detection limit; the last has its upper end, too."""
CALLED: Final = ("named", "set")
LEVEL: Final = 0.95

Document = Mapping[str, Any]
"""What was said of a case: what `marsarm diagnose --json` says, with `seconds` and `baselines`."""
Solved = tuple[TrueCase, Document]


@dataclass(frozen=True, slots=True)
class Middle:
    """A median with its exact interval; NaN and everything if there is nothing."""

    of: int
    median: float
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class Found:
    """Of true effects of the catalogue: how often they are found."""

    place: Rate
    """A first choice, or what it cannot be told from, sits there."""
    effect: Rate
    """A first choice is of its class."""
    in_set: Rate
    """Its class is in what was reported; nothing is where no name was given."""


@dataclass(frozen=True, slots=True)
class Bin:
    """The same of effects of some sizes, and how often outside effects of these get a wrong name."""

    least: float
    most: float
    found: Found
    wrong_name: Rate


@dataclass(frozen=True, slots=True)
class Baseline:
    """What another method makes of effects above the limit; NaN closure if it predicts nothing."""

    place: Rate
    effect: Rate
    closure: Middle


@dataclass(frozen=True, slots=True)
class Score:
    """Rates over cases; those of effects are of effects of the catalogue from the detection limit on."""

    cases: int
    false_alarm: Rate
    """No-effect cases called anything but none."""
    wrong_name: Rate
    """Cases of an effect outside the catalogue that were given a name (named or set)."""
    found: Found
    found_given: Found
    """Of those in whose cases a name or a set was given."""
    superfluous: Rate
    """Effects named in cases of the catalogue that are none of the case's."""
    set_size: float
    """Mean number of classes in a reported set; NaN if there is none."""
    covered: Rate
    """True sizes within their 90 % intervals, where the very effect was named."""
    closure: Middle
    """Of named effects, on held-out motion."""
    true_closure: Middle
    """What the true effects of the same cases, fitted, achieve."""
    closure_lost: Middle
    """By how much that is more, case by case."""
    seconds: Middle
    """Of CPU for a case."""
    most_seconds: float
    bins: tuple[Bin, ...]
    baselines: Mapping[str, Baseline]
    verdicts: Mapping[str, Mapping[str, int]]
    """How many cases of each kind got each verdict."""
    class_sizes: Mapping[int, int]
    """How many classes have so many members."""


def score(classes: Classes, solved: Sequence[Solved], true_closure: Callable[[TrueCase], float]) -> Score:
    """Of all cases; `true_closure` says what a case's true effects, fitted, achieve on held-out motion."""
    nothing = [said for true, said in solved if true.kind == "none"]
    outside = [(true, said) for true, said in solved if true.kind == "outside"]
    inside = [(true, said) for true, said in solved if true.kind in ("single", "pair")]
    each = [(one, said) for true, said in inside for one in true.effects]
    clear = [(one, said) for one, said in each if one.times_limit >= 1.0]
    sets = [len(_set(classes, one)) for _, said in inside for one in _reported(said)]
    told = [(true, said) for true, said in inside if _called(said) and _share(said) is not None]
    shares = [(_share(said) or 0.0, true_closure(true)) for true, said in told]
    seconds = [float(said["seconds"]) for _, said in solved]
    return Score(
        len(solved),
        _rate(said["verdict"] != "none" for said in nothing),
        _rate(_called(said) for _, said in outside),
        _found(classes, clear),
        _found(classes, [(one, said) for one, said in clear if _called(said)]),
        _rate(_superfluous(classes, true, one) for true, said in inside for one in _reported(said)),
        float(np.mean(sets)) if sets else float("nan"),
        _rate(hit for true, said in inside for hit in _covered(true, said)),
        middle([ours for ours, _ in shares]),
        middle([theirs for _, theirs in shares]),
        middle([theirs - ours for ours, theirs in shares]),
        middle(seconds),
        max(seconds, default=float("nan")),
        tuple(_bin(classes, least, most, each, outside) for least, most in BINS),
        _baselines(classes, clear, inside),
        _verdicts(solved),
        classes.sizes(),
    )


def middle(values: Sequence[float]) -> Middle:
    """A median; its interval is between two of the values, as the binomial has it."""
    known = np.sort([value for value in values if np.isfinite(value)])
    if not known.size:
        return Middle(0, float("nan"), float("-inf"), float("inf"))
    below = int(binom.ppf((1.0 - LEVEL) / 2.0, known.size, 0.5)) - 1
    least, most = (known[below], known[-1 - below]) if below >= 0 else (-np.inf, np.inf)
    return Middle(known.size, float(np.median(known)), float(least), float(most))


def _found(classes: Classes, each: Sequence[tuple[TrueEffect, Document]]) -> Found:
    return Found(
        _rate(one.place in _places(classes, _first(said)) for one, said in each),
        _rate(_class(classes, one) in _classes(classes, _first(said)) for one, said in each),
        _rate(
            any(_class(classes, one) in _set(classes, told) for told in _reported(said)) for one, said in each
        ),
    )


def _bin(
    classes: Classes,
    least: float,
    most: float,
    each: Sequence[tuple[TrueEffect, Document]],
    outside: Sequence[Solved],
) -> Bin:
    def within(one: TrueEffect) -> bool:
        return least <= one.times_limit < most or (most == BINS[-1][1] and one.times_limit >= most)

    mine = [(one, said) for one, said in each if within(one)]
    strange = [said for true, said in outside if within(true.effects[0])]
    return Bin(least, most, _found(classes, mine), _rate(_called(said) for said in strange))


def _baselines(
    classes: Classes, clear: Sequence[tuple[TrueEffect, Document]], inside: Sequence[Solved]
) -> dict[str, Baseline]:
    names = dict.fromkeys(name for _, said in inside for name in said["baselines"])
    return {name: _baseline(classes, name, clear, inside) for name in names}


def _baseline(
    classes: Classes,
    name: str,
    clear: Sequence[tuple[TrueEffect, Document]],
    inside: Sequence[Solved],
) -> Baseline:
    of = [(one, said["baselines"].get(name, {})) for one, said in clear]
    names, places = (any(key in said for _, said in of) for key in ("name", "place"))
    shares = [said["baselines"].get(name, {}).get("closure") for _, said in inside if _called(said)]
    return Baseline(
        _rate(one.place in _places_said(classes, said) for one, said in of if places),
        _rate("name" in said and _class(classes, one) == _class(classes, said) for one, said in of if names),
        middle([share for share in shares if share is not None]),
    )


def _verdicts(solved: Sequence[Solved]) -> dict[str, dict[str, int]]:
    result: dict[str, dict[str, int]] = {}
    for true, said in solved:
        row = result.setdefault(true.kind, {})
        row[said["verdict"]] = row.get(said["verdict"], 0) + 1
    return result


def _rate(hits: Iterable[bool]) -> Rate:
    told = list(hits)
    return estimate_rate(sum(told), len(told))


def _called(said: Document) -> bool:
    """Whether a name was given."""
    return said["verdict"] in CALLED


def _share(said: Document) -> float | None:
    """Of the explainable gap that was closed; None if hardly any was there."""
    closure = said["closure"]
    return None if closure is None else closure["share"]


def _first(said: Document) -> list[Document]:
    """First choices: the findings, or what would be if anything."""
    return list(said["effects"]) or list(said["ranking"][:1])


def _reported(said: Document) -> list[Document]:
    """The findings, where names were given."""
    return list(said["effects"]) if _called(said) else []


def _class(classes: Classes, one: TrueEffect | Document) -> int | None:
    if isinstance(one, TrueEffect):
        return classes.of(one.name, one.place)
    return classes.of(one["name"], one["place"])


def _classes(classes: Classes, told: Iterable[Document]) -> set[int | None]:
    return {_class(classes, one) for one in told}


def _set(classes: Classes, finding: Document) -> set[int | None]:
    """The classes of a finding and of what may stand in its stead."""
    return _classes(classes, (finding, *finding["alternatives"]))


def _places(classes: Classes, told: Iterable[Document]) -> set[str]:
    """Of these, and of what they cannot be told from."""
    labels = [label for label in _classes(classes, told) if label is not None]
    return {place for label in labels for place in classes.places(label)}


def _places_said(classes: Classes, said: Document) -> set[str]:
    """Of a baseline: by its class if it names an effect; none if it says nothing."""
    return _places(classes, [said]) if "name" in said else {said["place"]} if "place" in said else set()


def _superfluous(classes: Classes, true: TrueCase, finding: Document) -> bool:
    return _class(classes, finding) not in {_class(classes, one) for one in true.effects}


def _covered(true: TrueCase, said: Document) -> list[bool]:
    """Of every size of every true effect that was named."""
    found = {(one["name"], one["place"]): one for one in _reported(said)}
    result = []
    for effect in true.effects:
        finding = found.get((effect.name, effect.place))
        for told in finding["parameters"] if finding is not None else ():
            if told["is_size"]:
                result.append(bool(told["least"] <= effect.values[told["name"]] <= told["most"]))
    return result

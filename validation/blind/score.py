"""A folder of blind cases scored: first the seal, then what was said against what was true."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import binom

from fsw.kinematics.transforms import Array
from ground.common.progress import Progress
from ground.common.rates import Rate, estimate_rate
from ground.common.requests import BadRequest
from ground.diagnosis.blind_case import TrueCase, TrueEffect, load_truth
from ground.diagnosis.problem import Hypothesis
from validation.blind.case_features import (
    CampaignSensitivities,
    closure_of_truth,
    prepare_trial,
    read_case_features,
    split_case,
)
from validation.blind.classes import EquivalenceClasses, load_classes
from validation.blind.folder import CAMPAIGN_FOLDER, CASES_FOLDER, load_results
from validation.blind.solve import DIAGNOSIS_SEED, features_path

SIZE_BINS: Final = ((0.5, 1.0), (1.0, 1.5), (1.5, 2.0), (2.0, 4.0))
"""Of sizes over the detection limit; the last has its upper end, too."""
NAMED_VERDICTS: Final = ("named", "set")
CONFIDENCE_LEVEL: Final = 0.95

ResultDocument = Mapping[str, Any]
"""What was said of a case: what `marsarm diagnose --json` says, with `seconds` and `baselines`."""
SolvedCase = tuple[TrueCase, ResultDocument]


@dataclass(frozen=True, slots=True)
class Median:
    """A median with its exact interval; NaN and everything if there is nothing."""

    of: int
    median: float
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class DetectionRates:
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
    found: DetectionRates
    wrong_name: Rate


@dataclass(frozen=True, slots=True)
class Baseline:
    """What another method makes of effects above the limit; NaN closure if it predicts nothing."""

    place: Rate
    effect: Rate
    closure: Median


@dataclass(frozen=True, slots=True)
class Score:
    """Rates over cases; those of effects are of effects of the catalogue from the detection limit on."""

    cases: int
    false_alarm: Rate
    """No-effect cases called anything but none."""
    wrong_name: Rate
    """Cases of an effect outside the catalogue that were given a name (named or set)."""
    found: DetectionRates
    found_given: DetectionRates
    """Of those in whose cases a name or a set was given."""
    superfluous: Rate
    """Effects named in cases of the catalogue that are none of the case's."""
    set_size: float
    """Mean number of classes in a reported set; NaN if there is none."""
    covered: Rate
    """True sizes within their 90 % intervals, where the very effect was named."""
    closure: Median
    """Of named effects, on held-out motion."""
    true_closure: Median
    """What the true effects of the same cases, fitted, achieve."""
    closure_lost: Median
    """By how much that is more, case by case."""
    seconds: Median
    """Of CPU for a case."""
    most_seconds: float
    bins: tuple[Bin, ...]
    baselines: Mapping[str, Baseline]
    verdicts: Mapping[str, Mapping[str, int]]
    """How many cases of each kind got each verdict."""
    class_sizes: Mapping[int, int]
    """How many classes have so many members."""


def score(
    classes: EquivalenceClasses, solved: Sequence[SolvedCase], true_closure: Callable[[TrueCase], float]
) -> Score:
    """Of all cases; `true_closure` says what a case's true effects, fitted, achieve on held-out motion."""
    nothing = [said for true, said in solved if true.kind == "none"]
    outside = [(true, said) for true, said in solved if true.kind == "outside"]
    inside = [(true, said) for true, said in solved if true.kind in ("single", "pair")]
    each = [(one, said) for true, said in inside for one in true.effects]
    clear = [(one, said) for one, said in each if one.times_limit >= 1.0]
    sets = [len(_set(classes, one)) for _, said in inside for one in _reported(said)]
    told = [(true, said) for true, said in inside if _is_named(said) and _closure_share(said) is not None]
    shares = [(_closure_share(said) or 0.0, true_closure(true)) for true, said in told]
    seconds = [float(said["seconds"]) for _, said in solved]
    return Score(
        len(solved),
        _hit_rate(said["verdict"] != "none" for said in nothing),
        _hit_rate(_is_named(said) for _, said in outside),
        _detection_rates(classes, clear),
        _detection_rates(classes, [(one, said) for one, said in clear if _is_named(said)]),
        _hit_rate(_is_spurious(classes, true, one) for true, said in inside for one in _reported(said)),
        float(np.mean(sets)) if sets else float("nan"),
        _hit_rate(hit for true, said in inside for hit in _coverage_hits(true, said)),
        median_with_interval([ours for ours, _ in shares]),
        median_with_interval([theirs for _, theirs in shares]),
        median_with_interval([theirs - ours for ours, theirs in shares]),
        median_with_interval(seconds),
        max(seconds, default=float("nan")),
        tuple(_bin(classes, least, most, each, outside) for least, most in SIZE_BINS),
        _baselines(classes, clear, inside),
        _verdicts(solved),
        classes.sizes(),
    )


def median_with_interval(values: Sequence[float]) -> Median:
    """A median; its interval is between two of the values, as the binomial has it."""
    known = np.sort([value for value in values if np.isfinite(value)])
    if not known.size:
        return Median(0, float("nan"), float("-inf"), float("inf"))
    below = int(binom.ppf((1.0 - CONFIDENCE_LEVEL) / 2.0, known.size, 0.5)) - 1
    least, most = (known[below], known[-1 - below]) if below >= 0 else (-np.inf, np.inf)
    return Median(known.size, float(np.median(known)), float(least), float(most))


def _detection_rates(
    classes: EquivalenceClasses, each: Sequence[tuple[TrueEffect, ResultDocument]]
) -> DetectionRates:
    return DetectionRates(
        _hit_rate(one.place in _places(classes, _first(said)) for one, said in each),
        _hit_rate(_class(classes, one) in _classes(classes, _first(said)) for one, said in each),
        _hit_rate(
            any(_class(classes, one) in _set(classes, told) for told in _reported(said)) for one, said in each
        ),
    )


def _bin(
    classes: EquivalenceClasses,
    least: float,
    most: float,
    each: Sequence[tuple[TrueEffect, ResultDocument]],
    outside: Sequence[SolvedCase],
) -> Bin:
    def within(one: TrueEffect) -> bool:
        return least <= one.times_limit < most or (most == SIZE_BINS[-1][1] and one.times_limit >= most)

    mine = [(one, said) for one, said in each if within(one)]
    strange = [said for true, said in outside if within(true.effects[0])]
    return Bin(least, most, _detection_rates(classes, mine), _hit_rate(_is_named(said) for said in strange))


def _baselines(
    classes: EquivalenceClasses,
    clear: Sequence[tuple[TrueEffect, ResultDocument]],
    inside: Sequence[SolvedCase],
) -> dict[str, Baseline]:
    names = dict.fromkeys(name for _, said in inside for name in said["baselines"])
    return {name: _baseline(classes, name, clear, inside) for name in names}


def _baseline(
    classes: EquivalenceClasses,
    name: str,
    clear: Sequence[tuple[TrueEffect, ResultDocument]],
    inside: Sequence[SolvedCase],
) -> Baseline:
    of = [(one, said["baselines"].get(name, {})) for one, said in clear]
    names, places = (any(key in said for _, said in of) for key in ("name", "place"))
    shares = [said["baselines"].get(name, {}).get("closure") for _, said in inside if _is_named(said)]
    return Baseline(
        _hit_rate(one.place in _baseline_places(classes, said) for one, said in of if places),
        _hit_rate(
            "name" in said and _class(classes, one) == _class(classes, said) for one, said in of if names
        ),
        median_with_interval([share for share in shares if share is not None]),
    )


def _verdicts(solved: Sequence[SolvedCase]) -> dict[str, dict[str, int]]:
    result: dict[str, dict[str, int]] = {}
    for true, said in solved:
        row = result.setdefault(true.kind, {})
        row[said["verdict"]] = row.get(said["verdict"], 0) + 1
    return result


def _hit_rate(hits: Iterable[bool]) -> Rate:
    told = list(hits)
    return estimate_rate(sum(told), len(told))


def _is_named(said: ResultDocument) -> bool:
    """Whether a name was given."""
    return said["verdict"] in NAMED_VERDICTS


def _closure_share(said: ResultDocument) -> float | None:
    """Of the explainable gap that was closed; None if hardly any was there."""
    closure = said["closure"]
    return None if closure is None else closure["share"]


def _first(said: ResultDocument) -> list[ResultDocument]:
    """First choices: the findings, or what would be if anything."""
    return list(said["effects"]) or list(said["ranking"][:1])


def _reported(said: ResultDocument) -> list[ResultDocument]:
    """The findings, where names were given."""
    return list(said["effects"]) if _is_named(said) else []


def _class(classes: EquivalenceClasses, one: TrueEffect | ResultDocument) -> int | None:
    if isinstance(one, TrueEffect):
        return classes.of(one.name, one.place)
    return classes.of(one["name"], one["place"])


def _classes(classes: EquivalenceClasses, told: Iterable[ResultDocument]) -> set[int | None]:
    return {_class(classes, one) for one in told}


def _set(classes: EquivalenceClasses, finding: ResultDocument) -> set[int | None]:
    """The classes of a finding and of what may stand in its stead."""
    return _classes(classes, (finding, *finding["alternatives"]))


def _places(classes: EquivalenceClasses, told: Iterable[ResultDocument]) -> set[str]:
    """Of these, and of what they cannot be told from."""
    labels = [label for label in _classes(classes, told) if label is not None]
    return {place for label in labels for place in classes.places(label)}


def _baseline_places(classes: EquivalenceClasses, said: ResultDocument) -> set[str]:
    """Of a baseline: by its class if it names an effect; none if it says nothing."""
    return _places(classes, [said]) if "name" in said else {said["place"]} if "place" in said else set()


def _is_spurious(classes: EquivalenceClasses, true: TrueCase, finding: ResultDocument) -> bool:
    return _class(classes, finding) not in {_class(classes, one) for one in true.effects}


def _coverage_hits(true: TrueCase, said: ResultDocument) -> list[bool]:
    """Of every size of every true effect that was named."""
    found = {(one["name"], one["place"]): one for one in _reported(said)}
    result = []
    for effect in true.effects:
        finding = found.get((effect.name, effect.place))
        for told in finding["parameters"] if finding is not None else ():
            if told["is_size"]:
                result.append(bool(told["least"] <= effect.values[told["name"]] <= told["most"]))
    return result


def score_folder(
    folder: Path,
    kept_in: Callable[[Path], CampaignSensitivities],
    partial: bool,
    progress: Progress = lambda *_: None,
) -> Score:
    """Of all cases; `partial` of those that are solved.

    Raises:
        BadRequest: the truth is not what was sealed, cases are not solved, or what was said is damaged.
    """
    truth, said = load_truth(folder), load_results(folder)
    open_cases = [case.name for case in truth.cases if case.name not in said]
    if open_cases and (not partial or len(open_cases) == len(truth.cases)):
        raise BadRequest(
            f"{folder}: {len(open_cases)} of {len(truth.cases)} cases are not solved, {open_cases[0]} first; "
            f"`python -m validation.blind solve` goes on where it was, --partial scores those that are"
        )
    kept, done = kept_in(folder / CAMPAIGN_FOLDER), 0

    def true_closure(case: TrueCase) -> float:
        nonlocal done
        progress(done, len(said), case.name)
        done += 1
        features = read_case_features(features_path(folder / CASES_FOLDER / case.name))
        return closure_of_truth(
            prepare_trial(*split_case(kept, features)), _true_values(kept, case), DIAGNOSIS_SEED
        ).share

    solved = [(case, said[case.name]) for case in truth.cases if case.name in said]
    for case, told in solved:
        _check_sizes(case, told)
    return score(load_classes(folder / CAMPAIGN_FOLDER), solved, true_closure)


def _check_sizes(case: TrueCase, said: ResultDocument) -> None:
    """BadRequest if a true effect was given a size that it has not."""
    true = {(effect.name, effect.place): set(effect.values) for effect in case.effects}
    for finding in said["effects"]:
        sizes = {told["name"] for told in finding["parameters"] if told["is_size"]}
        for strange in sizes - true.get((finding["name"], finding["place"]), sizes):
            raise BadRequest(
                f"{case.name}: {finding['name']} has no {strange}; remove what was said of it and solve again"
            )


def _true_values(kept: CampaignSensitivities, case: TrueCase) -> dict[Hypothesis, Array]:
    """The true effects as the campaign's hypotheses."""
    known = {(one.effect, one.place): one for one in kept.fitted.hypotheses}
    strange = [effect for effect in case.effects if (effect.name, effect.place) not in known]
    if strange:
        raise BadRequest(
            f"{case.name}: {strange[0].name} at {strange[0].place} is not in today's catalogue; "
            f"score it with the marsarm that made it"
        )
    found = [(known[effect.name, effect.place], effect.values) for effect in case.effects]
    return {one: np.array([values[p.name] for p in one.parameters]) for one, values in found}

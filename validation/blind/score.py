"""Score of blind cases: checks the seal of the truth, then compares results with the truth."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import binom

from fsw.kinematics.transforms import Array
from ground.common.errors import BadRequest
from ground.common.progress import Progress
from ground.common.rates import Rate, estimate_rate
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
"""Bins of true amplitudes in detection limits; the last bin includes its upper end."""
NAMED_VERDICTS: Final = ("named", "set")
CONFIDENCE_LEVEL: Final = 0.95

ResultDocument = Mapping[str, Any]
"""Result document of a case (see `marsarm diagnose --json`), with `seconds` and `baselines`."""
SolvedCase = tuple[TrueCase, ResultDocument]


@dataclass(frozen=True, slots=True)
class Median:
    """Median with its exact interval; NaN with an infinite interval if there are no values."""

    of: int
    median: float
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class DetectionRates:
    """Rates at which true effects of the catalogue are found."""

    place: Rate
    """Rate at which a first choice, or its class, contains the place."""
    effect: Rate
    """Rate at which a first choice is of the right class."""
    in_set: Rate
    """Rate at which a reported set contains the class; a case without a name counts as a miss."""


@dataclass(frozen=True, slots=True)
class Bin:
    """Rates for true effects within a range of detection limits."""

    least: float
    most: float
    found: DetectionRates
    wrong_name: Rate


@dataclass(frozen=True, slots=True)
class Baseline:
    """Rates of a baseline for effects above the detection limit; NaN closure if it predicts nothing."""

    place: Rate
    effect: Rate
    closure: Median


@dataclass(frozen=True, slots=True)
class Score:
    """Rates over cases; rates of effects count catalogue effects from the detection limit on."""

    cases: int
    false_alarm: Rate
    """No-effect cases with a verdict other than "none"."""
    wrong_name: Rate
    """Out-of-catalogue cases with the verdict "named" or "set"."""
    found: DetectionRates
    found_given: DetectionRates
    """The same rates in cases with the verdict "named" or "set"."""
    spurious: Rate
    """Reported effects that are not effects of the case."""
    set_size: float
    """Mean number of classes in a reported set; NaN if there is none."""
    covered: Rate
    """True amplitudes within their 90 % intervals, where the effect itself was reported."""
    closure: Median
    """Closure of reported effects on held-out motion."""
    true_closure: Median
    """Closure of the true effects of the same cases, fitted."""
    closure_lost: Median
    """Difference of the two, case by case."""
    seconds: Median
    """CPU seconds for a case."""
    max_seconds: float
    bins: tuple[Bin, ...]
    baselines: Mapping[str, Baseline]
    verdicts: Mapping[str, Mapping[str, int]]
    """Number of cases by kind and verdict."""
    class_sizes: Mapping[int, int]
    """Number of classes by number of members."""


def score(
    classes: EquivalenceClasses, solved: Sequence[SolvedCase], true_closure: Callable[[TrueCase], float]
) -> Score:
    """Score all cases.

    Args:
        classes: Equivalence classes of the campaign.
        solved: Cases with their results.
        true_closure: Function that returns the closure of a case's true effects, fitted.
    """
    nothing = [result for true, result in solved if true.kind == "none"]
    outside = [(true, result) for true, result in solved if true.kind == "out-of-catalogue"]
    inside = [(true, result) for true, result in solved if true.kind in ("single", "pair")]
    each = [(one, result) for true, result in inside for one in true.effects]
    clear = [(one, result) for one, result in each if one.times_limit >= 1.0]
    sets = [len(_set(classes, one)) for _, result in inside for one in _reported(result)]
    named_cases = [
        (true, result) for true, result in inside if _is_named(result) and _closure_share(result) is not None
    ]
    shares = [(_closure_share(result) or 0.0, true_closure(true)) for true, result in named_cases]
    seconds = [float(result["seconds"]) for _, result in solved]
    return Score(
        len(solved),
        _hit_rate(result["verdict"] != "none" for result in nothing),
        _hit_rate(_is_named(result) for _, result in outside),
        _detection_rates(classes, clear),
        _detection_rates(classes, [(one, result) for one, result in clear if _is_named(result)]),
        _hit_rate(_is_spurious(classes, true, one) for true, result in inside for one in _reported(result)),
        float(np.mean(sets)) if sets else float("nan"),
        _hit_rate(hit for true, result in inside for hit in _coverage_hits(true, result)),
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
    """Return the median, with an interval between two of the values by the binomial distribution."""
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
        _hit_rate(one.place in _places(classes, _first(result)) for one, result in each),
        _hit_rate(_class(classes, one) in _classes(classes, _first(result)) for one, result in each),
        _hit_rate(
            any(_class(classes, one) in _set(classes, finding) for finding in _reported(result))
            for one, result in each
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

    mine = [(one, result) for one, result in each if within(one)]
    outside_results = [result for true, result in outside if within(true.effects[0])]
    return Bin(
        least,
        most,
        _detection_rates(classes, mine),
        _hit_rate(_is_named(result) for result in outside_results),
    )


def _baselines(
    classes: EquivalenceClasses,
    clear: Sequence[tuple[TrueEffect, ResultDocument]],
    inside: Sequence[SolvedCase],
) -> dict[str, Baseline]:
    names = dict.fromkeys(name for _, result in inside for name in result["baselines"])
    return {name: _baseline(classes, name, clear, inside) for name in names}


def _baseline(
    classes: EquivalenceClasses,
    name: str,
    clear: Sequence[tuple[TrueEffect, ResultDocument]],
    inside: Sequence[SolvedCase],
) -> Baseline:
    of = [(one, result["baselines"].get(name, {})) for one, result in clear]
    names, places = (any(key in result for _, result in of) for key in ("name", "place"))
    shares = [result["baselines"].get(name, {}).get("closure") for _, result in inside if _is_named(result)]
    return Baseline(
        _hit_rate(one.place in _baseline_places(classes, result) for one, result in of if places),
        _hit_rate(
            "name" in result and _class(classes, one) == _class(classes, result)
            for one, result in of
            if names
        ),
        median_with_interval([share for share in shares if share is not None]),
    )


def _verdicts(solved: Sequence[SolvedCase]) -> dict[str, dict[str, int]]:
    result: dict[str, dict[str, int]] = {}
    for true, outcome in solved:
        row = result.setdefault(true.kind, {})
        row[outcome["verdict"]] = row.get(outcome["verdict"], 0) + 1
    return result


def _hit_rate(hits: Iterable[bool]) -> Rate:
    outcomes = list(hits)
    return estimate_rate(sum(outcomes), len(outcomes))


def _is_named(result: ResultDocument) -> bool:
    """Check that the verdict gives a name."""
    return result["verdict"] in NAMED_VERDICTS


def _closure_share(result: ResultDocument) -> float | None:
    """Return the closure; None if there was too little to explain."""
    closure = result["closure"]
    return None if closure is None else closure["share"]


def _first(result: ResultDocument) -> list[ResultDocument]:
    """Return the first choices: the findings, else the best of the ranking."""
    return list(result["effects"]) or list(result["ranking"][:1])


def _reported(result: ResultDocument) -> list[ResultDocument]:
    """Return the findings if the verdict gives a name."""
    return list(result["effects"]) if _is_named(result) else []


def _class(classes: EquivalenceClasses, one: TrueEffect | ResultDocument) -> int | None:
    if isinstance(one, TrueEffect):
        return classes.of(one.name, one.place)
    return classes.of(one["name"], one["place"])


def _classes(classes: EquivalenceClasses, effects: Iterable[ResultDocument]) -> set[int | None]:
    return {_class(classes, one) for one in effects}


def _set(classes: EquivalenceClasses, finding: ResultDocument) -> set[int | None]:
    """Return the classes of a finding and of its alternatives."""
    return _classes(classes, (finding, *finding["alternatives"]))


def _places(classes: EquivalenceClasses, effects: Iterable[ResultDocument]) -> set[str]:
    """Return the places of these effects, and of the members of their classes."""
    labels = [label for label in _classes(classes, effects) if label is not None]
    return {place for label in labels for place in classes.places(label)}


def _baseline_places(classes: EquivalenceClasses, result: ResultDocument) -> set[str]:
    """Return the places of a baseline: by class if it names an effect."""
    return (
        _places(classes, [result]) if "name" in result else {result["place"]} if "place" in result else set()
    )


def _is_spurious(classes: EquivalenceClasses, true: TrueCase, finding: ResultDocument) -> bool:
    return _class(classes, finding) not in {_class(classes, one) for one in true.effects}


def _coverage_hits(true: TrueCase, document: ResultDocument) -> list[bool]:
    """Return for every amplitude of every reported true effect whether its interval contains the truth."""
    found = {(one["name"], one["place"]): one for one in _reported(document)}
    hits = []
    for effect in true.effects:
        finding = found.get((effect.name, effect.place))
        for parameter in finding["parameters"] if finding is not None else ():
            if parameter["is_amplitude"]:
                value = effect.values[parameter["name"]]
                hits.append(bool(parameter["least"] <= value <= parameter["most"]))
    return hits


def score_folder(
    folder: Path,
    kept_in: Callable[[Path], CampaignSensitivities],
    partial: bool,
    progress: Progress = lambda *_: None,
) -> Score:
    """Score the cases of a folder.

    Args:
        folder: Folder of blind cases.
        kept_in: Function that loads the sensitivities of a campaign folder.
        partial: Score only solved cases, instead of refusing a folder with unsolved ones.
        progress: Called with done, total and case.

    Raises:
        BadRequest: The truth does not match its digest, cases are unsolved, or a result is damaged.
    """
    truth, results = load_truth(folder), load_results(folder)
    open_cases = [case.name for case in truth.cases if case.name not in results]
    if open_cases and (not partial or len(open_cases) == len(truth.cases)):
        raise BadRequest(
            f"{folder}: {len(open_cases)} of {len(truth.cases)} cases are not solved, {open_cases[0]} first; "
            f"`python -m validation.blind solve` continues, --partial scores those that are solved"
        )
    sensitivities, done = kept_in(folder / CAMPAIGN_FOLDER), 0

    def true_closure(case: TrueCase) -> float:
        nonlocal done
        progress(done, len(results), case.name)
        done += 1
        features = read_case_features(features_path(folder / CASES_FOLDER / case.name))
        return closure_of_truth(
            prepare_trial(*split_case(sensitivities, features)),
            _true_values(sensitivities, case),
            DIAGNOSIS_SEED,
        ).share

    solved = [(case, results[case.name]) for case in truth.cases if case.name in results]
    for case, result in solved:
        _check_sizes(case, result)
    return score(load_classes(folder / CAMPAIGN_FOLDER), solved, true_closure)


def _check_sizes(case: TrueCase, result: ResultDocument) -> None:
    """Raise BadRequest if a result gives a true effect a parameter that it does not have."""
    true = {(effect.name, effect.place): set(effect.values) for effect in case.effects}
    for finding in result["effects"]:
        sizes = {parameter["name"] for parameter in finding["parameters"] if parameter["is_amplitude"]}
        for unknown in sizes - true.get((finding["name"], finding["place"]), sizes):
            raise BadRequest(
                f"{case.name}: {finding['name']} has no {unknown}; remove its result and solve again"
            )


def _true_values(sensitivities: CampaignSensitivities, case: TrueCase) -> dict[Hypothesis, Array]:
    """Return the true effects as hypotheses of the campaign."""
    known = {(one.effect, one.place): one for one in sensitivities.fitted.hypotheses}
    unknown = [effect for effect in case.effects if (effect.name, effect.place) not in known]
    if unknown:
        raise BadRequest(
            f"{case.name}: {unknown[0].name} at {unknown[0].place} is not in today's catalogue; "
            f"score it with the marsarm that made it"
        )
    found = [(known[effect.name, effect.place], effect.values) for effect in case.effects]
    return {one: np.array([values[p.name] for p in one.parameters]) for one, values in found}

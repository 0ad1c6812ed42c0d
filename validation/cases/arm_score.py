"""Score of blind cases of this arm: results compared with the truth, level by level, and its tables.

The classes, detection limits, families and locations of a campaign are published before its cases.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, FiniteFloat, TypeAdapter

from marsarm.common.rates import Median, Rate, median_with_interval, rate_of
from marsarm.diagnosis.model import DiagnosisModel
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from simgap.common.toml import read_json
from validation.cases.arm_truth import SealedEffect, TrueCase, load_outside_effects, locate_outside
from validation.cases.sealed import Table

CLASSES_FILE: Final = "classes.json"


@dataclass(frozen=True, slots=True)
class _Size:
    name: str
    low_90: FiniteFloat
    high_90: FiniteFloat


@dataclass(frozen=True, slots=True)
class _Sets:
    places: list[str]
    families: list[str]
    effects: list[str]


@dataclass(frozen=True, slots=True)
class _Finding:
    place: str
    effect: str
    level: Literal["effect", "family", "place", "none"]
    sizes: list[_Size]
    not_excluded: _Sets


@dataclass(frozen=True, slots=True)
class ResultFile:
    """Part of a result that the score reads."""

    verdict: Literal["named", "set", "none", "unknown"]
    findings: list[_Finding]
    seconds: FiniteFloat


@dataclass(frozen=True, slots=True)
class PublishedHypothesis:
    """Published facts of a hypothesis."""

    label: int
    """Equivalence class."""
    family_wise_share: float
    """Detection limit in the selection from all hypotheses, over that of a single test."""
    family: str
    location: str


_Limit = Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None


@dataclass(frozen=True, slots=True)
class _Entry:
    name: str
    place: str
    label: Annotated[int, Field(validation_alias="class")]
    limit: _Limit
    family_wise_limit: _Limit
    family: str
    location: str


_CLASSES_ADAPTER: Final = TypeAdapter(Annotated[list[_Entry], Field(min_length=1)])


@dataclass(frozen=True, slots=True)
class EquivalenceClasses:
    """Hypotheses of a campaign by effect and place, with the classes that it cannot distinguish."""

    known: Mapping[tuple[str, str], PublishedHypothesis]

    def of(self, effect: str, place: str) -> int | None:
        """Return the class of a hypothesis; None if the campaign does not have it."""
        found = self.known.get((effect, place))
        return None if found is None else found.label

    def locations(self, effect: str, place: str) -> frozenset[str]:
        """Return the locations of a hypothesis and of what is the same in this campaign."""
        return frozenset(one.location for one in self._alike(effect, place))

    def families(self, effect: str, place: str) -> frozenset[str]:
        """Return the families of a hypothesis and of what is the same in this campaign."""
        return frozenset(one.family for one in self._alike(effect, place))

    def family_wise_share(self, effect: str, place: str) -> float:
        """Return the limit in the selection over that of a single test; BadRequest if it is not known."""
        if (effect, place) not in self.known:
            raise BadRequest(
                f"{effect} at {place} is not in the catalogue of this campaign; score it with the marsarm "
                "that made it"
            )
        return self.known[effect, place].family_wise_share

    def _alike(self, effect: str, place: str) -> list[PublishedHypothesis]:
        label = self.of(effect, place)
        return [one for one in self.known.values() if label is not None and one.label == label]


def classes_json(model: DiagnosisModel) -> list[dict[str, Any]]:
    """Return the JSON document; an infinite limit is None."""
    rows = zip(
        model.sensitivities.hypotheses,
        model.label.tolist(),
        model.limits.tolist(),
        model.family_wise_limits.tolist(),
        model.families,
        model.locations,
        strict=True,
    )
    document: list[dict[str, Any]] = to_json([
        {
            "name": one.effect,
            "place": one.place,
            "class": label,
            "limit": limit,
            "family_wise_limit": family_wise_limit,
            "family": str(family),
            "location": location,
        }
        for one, label, limit, family_wise_limit, family, location in rows
    ])  # fmt: skip
    return document


def load_classes(campaign: Path) -> EquivalenceClasses:
    """Load what is published; BadRequest if it cannot be read."""
    path = campaign / CLASSES_FILE
    document = read_json(path, _CLASSES_ADAPTER, "holds no classes", "make the campaign anew")
    return EquivalenceClasses({
        (one.name, one.place): PublishedHypothesis(
            one.label, one.family_wise_limit / one.limit, one.family, one.location
        )
        for one in document
        if one.limit is not None and one.family_wise_limit is not None
    })  # fmt: skip


BOOTSTRAP_DRAWS: Final = 2000

ResultDocument = Mapping[str, Any]
"""Result document of a case (see `marsarm diagnose --json`), with `seconds`."""
FindingDocument = Mapping[str, Any]
SolvedCase = tuple[TrueCase, ResultDocument]


@dataclass(frozen=True, slots=True)
class Score:
    """Rates over cases."""

    cases: int
    false_alarm: Rate
    """No-effect cases with a verdict other than "none"."""
    reported: Rate
    """Effects of the catalogue, from the detection limit of the selection on, for which a finding stands."""
    place: Rate
    """Of those reported: that finding, or what is the same here, has the location."""
    effect: Rate
    """Of those reported: that finding is of the right class."""
    covered: Rate
    """Of those reported with a place: the set at the reported level holds the truth."""
    spurious: Rate
    """Named effects that are not effects of the case, in cases with effects of the catalogue."""
    interval: Rate
    """True amplitudes within their 90 % intervals, where the effect itself is named."""
    wrong: Mapping[str, Rate]
    """Cases outside the catalogue with a wrong statement, by level: place, family, effect."""
    by_effect: Mapping[str, tuple[float, float]]
    """Intervals of these rates, from a bootstrap over effects."""
    outside_reported: Rate
    """Cases outside the catalogue with a finding, or with something that remains."""
    seconds: Median
    """CPU seconds for a case."""
    max_seconds: float


@dataclass(frozen=True, slots=True)
class _Assigned:
    """A true effect, its size in limits of the selection, and the finding that stands for it, if any."""

    effect: SealedEffect
    times_family_wise: float
    finding: FindingDocument | None


def score(classes: EquivalenceClasses, solved: Sequence[SolvedCase]) -> Score:
    """Score all cases by the equivalence classes of their campaign."""
    nothing = [result for true, result in solved if true.kind == "none"]
    outside = [(true, result) for true, result in solved if true.kind == "out-of-catalogue"]
    inside = [(true, result) for true, result in solved if true.kind in ("single", "pair")]
    assigned = [one for true, result in inside for one in _assign(classes, true, result)]
    clear = [one for one in assigned if one.times_family_wise >= 1.0]
    given = [(one.effect, one.finding) for one in clear if one.finding is not None]
    named = [(true, one) for true, result in inside for one in _named(result)]
    seconds = [float(result["seconds"]) for _, result in solved]
    wrong = {
        "place": [_says_wrong_place(true.effects[0], result) for true, result in outside],
        "family": [_says_wrong_family(true.effects[0], result) for true, result in outside],
        "effect": [any(_named(result)) for _, result in outside],
    }
    names = [true.effects[0].name for true, _ in outside]
    return Score(
        cases=len(solved),
        false_alarm=rate_of(result["verdict"] != "none" for result in nothing),
        reported=rate_of(one.finding is not None for one in clear),
        place=rate_of(
            bool(classes.locations(one.name, one.place) & classes.locations(found["effect"], found["place"]))
            for one, found in given
        ),
        effect=rate_of(
            _class(classes, one) == classes.of(found["effect"], found["place"]) for one, found in given
        ),
        covered=rate_of(_is_covered(classes, one, found) for one, found in given if found["level"] != "none"),
        spurious=rate_of(
            not _classes(classes, one) & {_class(classes, effect) for effect in true.effects}
            for true, one in named
        ),
        interval=rate_of(hit for true, result in inside for hit in _interval_hits(true, result)),
        wrong={level: rate_of(hits) for level, hits in wrong.items()},
        by_effect={level: _bootstrap_over(names, hits) for level, hits in wrong.items()},
        outside_reported=rate_of(result["verdict"] != "none" for _, result in outside),
        seconds=median_with_interval(seconds),
        max_seconds=max(seconds, default=float("nan")),
    )


def _assign(classes: EquivalenceClasses, true: TrueCase, result: ResultDocument) -> list[_Assigned]:
    """Assign a finding to each true effect: one that names its class, else its place, else any other."""
    free = list(result["findings"])
    assigned: dict[int, FindingDocument] = {}
    rules: tuple[Callable[[SealedEffect, FindingDocument], bool], ...] = (
        lambda effect, one: _class(classes, effect) in _classes(classes, one),
        lambda effect, one: bool(classes.locations(effect.name, effect.place) & _places(one)),
        lambda effect, one: True,
    )
    order = sorted(range(len(true.effects)), key=lambda k: -true.effects[k].times_limit)
    for rule in rules:
        for k in order:
            found = next((one for one in free if rule(true.effects[k], one)), None)
            if k not in assigned and found is not None:
                assigned[k] = found
                free.remove(found)
    return [
        _Assigned(
            effect, effect.times_limit / classes.family_wise_share(effect.name, effect.place), assigned.get(k)
        )
        for k, effect in enumerate(true.effects)
    ]


def _is_covered(classes: EquivalenceClasses, one: SealedEffect, found: FindingDocument) -> bool:
    """Check that the set at the level of a finding holds the truth."""
    if found["level"] == "effect":
        return _class(classes, one) in _classes(classes, found)
    has_place = bool(classes.locations(one.name, one.place) & _places(found))
    if found["level"] == "place":
        return has_place
    return has_place and bool(classes.families(one.name, one.place) & set(found["not_excluded"]["families"]))


def _places(found: FindingDocument) -> set[str]:
    """Return the places of a finding; none if it is not located."""
    return set() if found["level"] == "none" else set(found["not_excluded"]["places"])


def _says_wrong_place(true: SealedEffect, result: ResultDocument) -> bool:
    """Check that a finding has places, and not that of the effect."""
    location = locate_outside(true.name, true.place)
    places = [_places(one) for one in result["findings"]]
    return any(one and location not in one for one in places)


def _says_wrong_family(true: SealedEffect, result: ResultDocument) -> bool:
    """Check that a finding has families, and none that counts as right."""
    right = load_outside_effects()[true.name].families
    families = [
        set(one["not_excluded"]["families"])
        for one in result["findings"]
        if one["level"] in ("effect", "family")
    ]
    return any(not right & one for one in families)


def _bootstrap_over(names: Sequence[str], hits: Sequence[bool]) -> tuple[float, float]:
    """Return the 95 % interval of a rate over draws of effects with replacement; NaN without a case."""
    kinds, of = np.unique(list(names), return_inverse=True)
    if not kinds.size:
        return float("nan"), float("nan")
    count, wrong = np.bincount(of), np.bincount(of, weights=np.asarray(hits, float))
    drawn = np.random.default_rng(0).integers(kinds.size, size=(BOOTSTRAP_DRAWS, kinds.size))
    rates = wrong[drawn].sum(axis=1) / count[drawn].sum(axis=1)
    least, most = np.quantile(rates, (0.025, 0.975))
    return float(least), float(most)


def _named(result: ResultDocument) -> list[FindingDocument]:
    return [one for one in result["findings"] if one["level"] == "effect"]


def _class(classes: EquivalenceClasses, one: SealedEffect) -> int | None:
    return classes.of(one.name, one.place)


def _classes(classes: EquivalenceClasses, finding: FindingDocument) -> set[int | None]:
    """Return the class of a finding and those of its set of effects."""
    pairs = [key.split(": ", 1) for key in finding["not_excluded"]["effects"]]
    return {classes.of(effect, place) for place, effect in ((finding["place"], finding["effect"]), *pairs)}


def _interval_hits(true: TrueCase, document: ResultDocument) -> list[bool]:
    """Return for every amplitude of every named true effect whether its interval contains the truth."""
    found = {(one["effect"], one["place"]): one for one in _named(document)}
    hits = []
    for effect in true.effects:
        finding = found.get((effect.name, effect.place))
        for size in finding["sizes"] if finding is not None else ():
            value = effect.values[size["name"].removeprefix("ln_")]
            hits.append(bool(size["low_90"] <= value <= size["high_90"]))
    return hits


def make_tables(score: Score) -> tuple[Table, ...]:
    """Return the tables of the page; intervals are exact, 95 %, those by effect from a bootstrap."""
    bars = (
        ("no effect called one", "9 % or fewer", score.false_alarm),
        ("reported, from the limit of the selection on", "85 %", score.reported),
        ("right place, of those", "95 %", score.place),
        ("right effect as first choice, of those", "88 %", score.effect),
        ("in the set of the level that was reported", "95 %", score.covered),
        ("named, but not of the case", "", score.spurious),
        ("90 % intervals that cover", "85 to 95 %", score.interval),
        ("CPU seconds for a case, median", "10 or fewer", f"{score.seconds.median:.1f}"),
        ("the longest", "", f"{score.max_seconds:.1f}"),
    )
    outside = [
        (f"wrong {level}, {bar} % or fewer", _outside_text(score.wrong[level], score.by_effect[level]))
        for level, bar in (("place", 8), ("family", 14), ("effect", 20))
    ]
    outside.append(("something is reported", str(score.outside_reported)))
    rows = tuple((name, wanted, str(value)) for name, wanted, value in bars)
    return (
        Table(f"{score.cases} blind cases", ("", "wanted", "found"), rows),
        Table("Outside the catalogue", ("", "found"), tuple(outside)),
    )


def _outside_text(rate: Rate, by_effect: tuple[float, float]) -> str:
    between = " to ".join(f"{100 * one:.1f}" for one in by_effect)
    return f"{100 * rate.share:.1f} % ({rate.hits} of {rate.of}; {between})" if rate.of else "no case"

"""Score of blind cases of this arm: results compared with the truth, level by level.

The classes, detection limits, families and locations of a campaign are published before its cases.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any, Final

from pydantic import Field, TypeAdapter

from marsarm.common.rates import rate_of
from marsarm.diagnosis.model import DiagnosisModel
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from simgap.common.toml import read_json
from validation.cases.arm_truth import SealedEffect, TrueCase, load_outside_effects, locate_outside
from validation.cases.sealed import CaseScore, JudgedEffect, level_bars, score_bars

CLASSES_FILE: Final = "classes.json"


_Limit = Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None


@dataclass(frozen=True, slots=True)
class PublishedHypothesis:
    """Published facts of a hypothesis; a limit is None if the campaign does not show it."""

    name: str
    place: str
    label: Annotated[int, Field(validation_alias="class")]
    """Equivalence class."""
    limit: _Limit
    family_wise_limit: _Limit
    """Detection limit in the selection from all hypotheses."""
    family: str
    location: str


_CLASSES_ADAPTER: Final = TypeAdapter(Annotated[list[PublishedHypothesis], Field(min_length=1)])


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

    def times_limit(self, true: SealedEffect) -> float:
        """Return the size of an effect in limits of the selection; BadRequest if it is not known."""
        if (true.name, true.place) not in self.known:
            raise BadRequest(
                f"{true.name} at {true.place} is not in the catalogue of this campaign; score it with the "
                "marsarm that made it"
            )
        one = self.known[true.name, true.place]
        assert one.limit is not None
        assert one.family_wise_limit is not None
        return true.times_limit / (one.family_wise_limit / one.limit)

    def _alike(self, effect: str, place: str) -> list[PublishedHypothesis]:
        label = self.of(effect, place)
        return [one for one in self.known.values() if label is not None and one.label == label]


def classes_json(model: DiagnosisModel) -> list[dict[str, Any]]:
    """Return the JSON document; an infinite limit is None."""
    names = ("class", "limit", "family_wise_limit", "family", "location")
    numbers = (one.tolist() for one in (model.label, model.limits, model.family_wise_limits))
    every = model.sensitivities.hypotheses
    rows = zip(*numbers, [str(one.family) for one in every], [one.location for one in every], strict=True)
    document: list[dict[str, Any]] = to_json([
        {"name": one.name, "place": one.place} | dict(zip(names, row, strict=True))
        for one, row in zip(every, rows, strict=True)
    ])  # fmt: skip
    return document


def load_classes(campaign: Path) -> EquivalenceClasses:
    """Load what is published; BadRequest if it cannot be read."""
    path = campaign / CLASSES_FILE
    document = read_json(path, _CLASSES_ADAPTER, "holds no classes", "make the campaign anew")
    seen = [one for one in document if one.limit is not None and one.family_wise_limit is not None]
    return EquivalenceClasses({(one.name, one.place): one for one in seen})


WRONG_RATES: Final = (0.08, 0.14, 0.20)
"""Bars of wrong places, families and effects outside the catalogue."""

ResultDocument = Mapping[str, Any]
"""Result document of a case (see `marsarm diagnose --json`), with `seconds`."""
FindingDocument = Mapping[str, Any]
SolvedCase = tuple[TrueCase, ResultDocument]


def score(classes: EquivalenceClasses, solved: Sequence[SolvedCase]) -> CaseScore:
    """Score all cases by the equivalence classes of their campaign."""
    alarms = [result["verdict"] != "none" for true, result in solved if true.kind == "none"]
    outside = [(true.effects[0], result) for true, result in solved if true.kind == "out-of-catalogue"]
    wrong = [_find_wrong(*one) for one in outside]
    inside = [(true, result) for true, result in solved if true.kind in ("single", "pair")]
    assigned = [one for true, result in inside for one in _assign(classes, true, result)]
    clear = [_judge(classes, *one) for one in assigned if classes.times_limit(one[0]) >= 1.0]
    seconds = [float(result["seconds"]) for _, result in solved]
    more = {
        "named, but not of the case": rate_of(
            not _classes(classes, one) & {_class(classes, effect) for effect in true.effects}
            for true, result in inside
            for one in _named(result)
        ),
        "90 % intervals that cover": rate_of(
            hit for true, result in inside for hit in _interval_hits(true, result)
        ),
        "outside, reported": rate_of(result["verdict"] != "none" for _, result in outside),
        "cpu seconds, median": median(seconds),
        "cpu seconds, longest": max(seconds),
    }
    return score_bars(level_bars(alarms, wrong, clear, WRONG_RATES), len(solved), to_json(more))


def _judge(classes: EquivalenceClasses, true: SealedEffect, found: FindingDocument | None) -> JudgedEffect:
    if found is None:
        return JudgedEffect(False)
    first = found["effect"], found["place"]
    has_place = bool(classes.locations(true.name, true.place) & classes.locations(*first))
    covered = None if found["level"] == "none" else _is_covered(classes, true, found)
    return JudgedEffect(True, has_place, _class(classes, true) == classes.of(*first), covered)


def _assign(
    classes: EquivalenceClasses, true: TrueCase, result: ResultDocument
) -> list[tuple[SealedEffect, FindingDocument | None]]:
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
    return [(effect, assigned.get(k)) for k, effect in enumerate(true.effects)]


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


def _find_wrong(true: SealedEffect, result: ResultDocument) -> tuple[bool, bool, bool]:
    """Return whether a finding has places without that of the effect, no right family, or a name."""
    location, right = locate_outside(true.name, true.place), load_outside_effects()[true.name].families
    places = [_places(one) for one in result["findings"]]
    told = [one for one in result["findings"] if one["level"] in ("effect", "family")]
    return (
        any(one and location not in one for one in places),
        any(not right & set(one["not_excluded"]["families"]) for one in told),
        any(_named(result)),
    )


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

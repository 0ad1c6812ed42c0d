"""Files of the campaign and of solved cases of this arm: equivalence classes, and results.

The classes, detection limits, families and locations of a campaign are published before its cases.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, FiniteFloat, TypeAdapter

from marsarm.diagnosis.model import DiagnosisModel
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from simgap.common.toml import read_json

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

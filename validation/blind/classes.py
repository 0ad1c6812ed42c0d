"""The campaign's classes and detection limits, published before there are cases."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from ground.common.requests import BadRequest
from ground.diagnosis.problem import Hypothesis, Ints
from ground.diagnosis.result import finite_or_none

CLASSES_FILE: Final = "classes.json"
EffectAndPlace = tuple[str, str]
"""Effect and place."""


@dataclass(frozen=True, slots=True)
class EquivalenceClasses:
    """Which hypotheses the campaign cannot tell apart."""

    label: Mapping[EffectAndPlace, int]

    def of(self, effect: str, place: str) -> int | None:
        """The class of one; None if the campaign has no such hypothesis."""
        return self.label.get((effect, place))

    def places(self, label: int) -> frozenset[str]:
        """Where its members sit."""
        return frozenset(place for (_, place), one in self.label.items() if one == label)

    def sizes(self) -> dict[int, int]:
        """How many classes have how many members."""
        _, members = np.unique(list(self.label.values()), return_counts=True)
        return {int(size): int(np.sum(members == size)) for size in np.unique(members)}


def classes_json(
    hypotheses: tuple[Hypothesis, ...], label: Ints, limits: list[float]
) -> list[dict[str, Any]]:
    """As a document; a limit that is infinite is None: the effect is not seen."""
    return [
        {
            "name": one.effect,
            "place": one.place,
            "class": int(number),
            "limit": finite_or_none(limit),
        }
        for one, number, limit in zip(hypotheses, label, limits, strict=True)
    ]


def load_classes(campaign: Path) -> EquivalenceClasses:
    """As they were published; BadRequest if they cannot be read."""
    try:
        said = json.loads((campaign / CLASSES_FILE).read_bytes())
        return EquivalenceClasses(
            {(one["name"], one["place"]): one["class"] for one in said if one["limit"] is not None}
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadRequest(
            f"{campaign / CLASSES_FILE}: holds no classes ({error}); make the campaign anew"
        ) from error

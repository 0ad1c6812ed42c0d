"""Equivalence classes and detection limits of a campaign, published before its cases."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from ground.common.errors import BadRequest
from ground.diagnosis.problem import Hypothesis, Ints
from ground.diagnosis.result import finite_or_none

CLASSES_FILE: Final = "classes.json"
EffectAndPlace = tuple[str, str]
"""Effect and place."""


@dataclass(frozen=True, slots=True)
class EquivalenceClasses:
    """Classes of hypotheses that the campaign cannot distinguish."""

    label: Mapping[EffectAndPlace, int]

    def of(self, effect: str, place: str) -> int | None:
        """Return the class of a hypothesis; None if the campaign does not have it."""
        return self.label.get((effect, place))

    def places(self, label: int) -> frozenset[str]:
        """Return the places of the members."""
        return frozenset(place for (_, place), one in self.label.items() if one == label)

    def sizes(self) -> dict[int, int]:
        """Return the number of classes by number of members."""
        _, members = np.unique(list(self.label.values()), return_counts=True)
        return {int(size): int(np.sum(members == size)) for size in np.unique(members)}


def classes_json(
    hypotheses: tuple[Hypothesis, ...], label: Ints, limits: list[float]
) -> list[dict[str, Any]]:
    """Return the JSON document; an infinite limit is None."""
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
    """Load the published classes; BadRequest if they cannot be read."""
    try:
        document = json.loads((campaign / CLASSES_FILE).read_bytes())
        return EquivalenceClasses(
            {(one["name"], one["place"]): one["class"] for one in document if one["limit"] is not None}
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadRequest(
            f"{campaign / CLASSES_FILE}: holds no classes ({error}); make the campaign anew"
        ) from error

"""What the logs of one case say, in terms of the campaign's sensitivities, fitted and held out apart."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.kinematics.transforms import Array
from ground.common.requests import BadRequest
from ground.diagnosis.layout import Ints
from ground.diagnosis.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A campaign's sensitivities, of the motions that are fitted and of those that are held out."""

    fitted: Sensitivities
    held: Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Which features of the campaign a case has, and what was measured less predicted, (n,) each."""

    rows: Ints
    value: Array


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Of a case."""

    fitted: Measured
    held: Measured

    def document(self) -> dict[str, Any]:
        """Plain; every number comes back as it was."""
        return {
            name: {"rows": one.rows.tolist(), "value": one.value.tolist()}
            for name, one in (("fitted", self.fitted), ("held", self.held))
        }


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Some features: their sensitivities, and what was measured less predicted."""

    found: Sensitivities
    value: Array


def parts(kept: Kept, case: Features) -> tuple[Part, Part]:
    """What a diagnosis is made of, and what it is tried on."""
    fitted = Part(kept.fitted.of(case.fitted.rows), case.fitted.value)
    return fitted, Part(kept.held.of(case.held.rows), case.held.value)


def read_features(path: Path) -> Features:
    """As they were written; BadRequest if they cannot be read."""
    try:
        said = json.loads(path.read_bytes())
        fitted, held = (
            Measured(np.array(said[name]["rows"], np.intp), np.array(said[name]["value"], float))
            for name in ("fitted", "held")
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        solved = path.name.replace(".features", "")
        raise BadRequest(f"{path}: holds no features ({error}); remove {solved} and solve again") from error
    return Features(fitted, held)

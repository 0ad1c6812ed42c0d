"""What the logs of one case say, in terms of the campaign's sensitivities, fitted and held out apart."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.gap.layout import Ints
from ground.gap.sensitivity import Sensitivities


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A campaign's sensitivities, and which of their features (m,) are held out of every diagnosis."""

    found: Sensitivities
    held_out: Flags


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A case: which features of the campaign it has, and what was measured less predicted, (n,) each."""

    rows: Ints
    value: Array

    def document(self) -> dict[str, Any]:
        """Plain; every number comes back as it was."""
        return {"rows": self.rows.tolist(), "value": self.value.tolist()}


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Some features: their sensitivities, and what was measured less predicted."""

    found: Sensitivities
    value: Array


def parts(kept: Kept, measured: Measured) -> tuple[Part, Part]:
    """What a diagnosis is made of, and what it is tried on."""
    held_out = kept.held_out[measured.rows]
    fitted, held = (
        Part(kept.found.of(measured.rows[mask]), measured.value[mask]) for mask in (~held_out, held_out)
    )
    return fitted, held


def read_measured(path: Path) -> Measured:
    """As it was written."""
    said = json.loads(path.read_bytes())
    return Measured(np.array(said["rows"], np.intp), np.array(said["value"], float))

"""What makes a tool be elsewhere than it should: the sources of error as data, and the cases they make up.

Paper, Tables 2 and 4. A magnitude is what an error stays within, plus or minus; its spread says how it lies
in there.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Final, Literal

import numpy as np
from pydantic import TypeAdapter

from fsw.dictionary.enums import Frame
from fsw.dictionary.types import Vector3
from fsw.kinematics.transforms import Array

Distribution = Literal["normal", "uniform", "either side"]

CUMULANTS: Final[dict[Distribution, tuple[float, float, float]]] = {
    "normal": (1 / 9, 0.0, 0.0),
    "uniform": (1 / 3, -2 / 15, 16 / 63),
    "either side": (1.0, -2.0, 16.0),
}
"""Second, fourth and sixth, of magnitude 1: three sigma, anywhere within, at one end or the other."""

EffectName = Literal[
    "frame error", "frame play", "servo error", "windup", "hardstop angle", "backlash", "stiffness", "warming"
]

FrameName = Literal["arm1", "arm2", "arm3", "arm4", "arm5", "arm6", "tool"]


@dataclass(frozen=True, slots=True)
class FrameMagnitude:
    """An error of some frames, in their own axes."""

    frames: tuple[FrameName, ...]
    rotation_mrad: Vector3 = (0.0, 0.0, 0.0)
    translation_mm: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ErrorSource:
    """One source of error."""

    kind: Literal["systematic", "random"]
    text: str
    label: Literal["S", "I", "A"]
    """Where the magnitude comes from: a public document, inferred, assumed."""
    basis: str
    distribution: Distribution
    effect: EffectName
    """How it acts in the plant."""
    at_limit: bool = False
    """Whether it may well lie at the end of its range: added, not root-sum-squared (paper equation 13)."""
    relative_to: Literal["frames", "load", "temperature"] = "frames"
    """What the error is a share of: nothing, the deflection under the load, the growth over a warming."""
    at: tuple[FrameMagnitude, ...] = ()
    share: float = 0.0
    warming_K: float = 0.0

    @property
    def theta(self) -> Array:
        """Magnitudes (6, 7) at the frames: turns [rad], then shifts [m]; zero for a share of something."""
        theta = np.zeros((6, len(Frame)))
        for place in self.at:
            for name in place.frames:
                theta[:3, Frame[name.upper()]] += np.array(place.rotation_mrad) * 1e-3
                theta[3:, Frame[name.upper()]] += np.array(place.translation_mm) * 1e-3
        return theta


@dataclass(frozen=True, slots=True)
class BudgetCase:
    """Which sources count, and how many times their magnitude."""

    text: str
    sources: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """All sources and all cases."""

    source: Mapping[str, ErrorSource]
    case: Mapping[str, BudgetCase]


def is_compensated(backlash: float) -> bool:
    """Whether flight software allows for backlash, of which so much is left."""
    return backlash < 1


def load_error_model() -> ErrorModel:
    """The sources and cases of the house."""
    text = resources.files("ground.accuracy").joinpath("sources.toml").read_text(encoding="utf-8")
    model: ErrorModel = TypeAdapter(ErrorModel).validate_python(tomllib.loads(text))
    return model

"""Error sources of a tool as data, and cases that combine them (paper, Tables 2 and 4).

An error stays within plus or minus its magnitude; its distribution describes it there.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
from pydantic import TypeAdapter

from fsw.dictionary.enums import Frame
from fsw.dictionary.types import Vector3
from fsw.kinematics.transforms import Array
from simgap.common.files import file_sha256
from simgap.common.toml import read_toml

SOURCES_FILE: Final = Path(str(resources.files("marsarm.accuracy") / "sources.toml"))
Distribution = Literal["normal", "uniform", "either side"]

CUMULANTS: Final[dict[Distribution, tuple[float, float, float]]] = {
    "normal": (1 / 9, 0.0, 0.0),
    "uniform": (1 / 3, -2 / 15, 16 / 63),
    "either side": (1.0, -2.0, 16.0),
}
"""Second, fourth and sixth cumulants for magnitude 1.

The magnitude is three sigma (normal), the half width (uniform), or one of two values (either side).
"""

EffectName = Literal[
    "frame error", "frame play", "servo error", "windup", "hardstop angle", "backlash", "stiffness", "warming"
]

FrameName = Literal["arm1", "arm2", "arm3", "arm4", "arm5", "arm6", "tool"]
FRAME_NAMES: Final[tuple[FrameName, ...]] = get_args(FrameName)


@dataclass(frozen=True, slots=True)
class FrameMagnitude:
    """Magnitude of an error of some frames, in their own axes."""

    frames: tuple[FrameName, ...]
    rotation_mrad: Vector3 = (0.0, 0.0, 0.0)
    translation_mm: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ErrorSource:
    """Error source with its magnitude and distribution."""

    kind: Literal["systematic", "random"]
    text: str
    label: Literal["S", "I", "A"]
    """Origin of the magnitude: a public document (S), inferred (I), assumed (A)."""
    basis: str
    distribution: Distribution
    effect: EffectName
    """Kind of effect in the plant."""
    at_limit: bool = False
    """True if the error may be at the end of its range, so that it is added (paper equation 13)."""
    relative_to: Literal["frames", "load", "temperature"] = "frames"
    """Reference of the magnitude: none, the deflection under load, or the expansion by warming."""
    at: tuple[FrameMagnitude, ...] = ()
    frames: tuple[FrameName, ...] = FRAME_NAMES
    """Frames of an error relative to load or temperature."""
    share: float = 0.0
    warming_K: float = 0.0

    @property
    def share_by_frame(self) -> Array:
        """Compute the share at each frame, shape (7,); zero at other frames than those of the source."""
        return self.share * np.array([frame.name.lower() in self.frames for frame in Frame])

    @property
    def theta(self) -> Array:
        """Compute the magnitudes at the frames, rotations [rad] above translations [m], shape (6, 7).

        They are zero for a source relative to load or temperature.
        """
        theta = np.zeros((6, len(Frame)))
        for magnitude in self.at:
            for name in magnitude.frames:
                theta[:3, Frame[name.upper()]] += np.array(magnitude.rotation_mrad) * 1e-3
                theta[3:, Frame[name.upper()]] += np.array(magnitude.translation_mm) * 1e-3
        return theta


@dataclass(frozen=True, slots=True)
class BudgetCase:
    """Sources of a case, with factors of their magnitudes."""

    text: str
    sources: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """All error sources and all cases."""

    source: Mapping[str, ErrorSource]
    case: Mapping[str, BudgetCase]


def is_compensated(backlash: float) -> bool:
    """Return whether flight software compensates backlash, given the factor of the source."""
    return backlash < 1


@cache
def load_error_model() -> ErrorModel:
    """Load the error sources and cases of the project, once in a process."""
    model: ErrorModel = TypeAdapter(ErrorModel).validate_python(read_toml(SOURCES_FILE))
    return model


def sources_sha256() -> str:
    """Compute the SHA-256 of the file of error sources and cases."""
    return file_sha256(SOURCES_FILE)

"""Search for magnitudes that reproduce the paper's budget, with the smallest change of the assumed ones."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians
from typing import Final, Literal

import numpy as np
from scipy.optimize import least_squares

from fsw.config import Config
from fsw.dictionary.enums import Frame
from fsw.dictionary.types import Vector3, vector3
from fsw.kinematics.transforms import Array
from marsarm.accuracy.combine import COVERAGE, bounds, paper_rule
from marsarm.accuracy.sensitivity import Sensitivity, compute_sensitivity, workspace_poses
from marsarm.accuracy.sources import ErrorModel, ErrorSource, FrameMagnitude

Component = Literal["total_m", "lateral_m", "normal_m", "axial_rad"]
REQUIRED_TOTAL_M: Final = 0.020
REQUIRED_LATERAL_M: Final = 0.015
REQUIRED_AXIAL_RAD: Final = radians(9.8)
REPEAT_LATERAL_M: Final = 0.010
REPEAT_NORMAL_M: Final = 0.010
REPEAT_AXIAL_RAD: Final = radians(2.0)
"""Requirements of Tables 3 and 4, plus or minus: accuracy (REQUIRED), repeatability (REPEAT)."""
POSES_A_TOOL: Final = 300
ROW_TOLERANCE: Final = 0.01
"""A relative error of a row by this share costs as much as a change of a magnitude by a factor of e."""
SHARE: Final = "share"
SourcePart = tuple[str, str]
"""Name of a source, and name of a part of its magnitudes."""


@dataclass(frozen=True, slots=True)
class PaperRow:
    """Row of a table of the paper; plus or minus, in metres or radians."""

    name: str
    case: str
    component: Component
    required: float
    estimated: float


def _paper_rows(accuracy: str, again: str, estimated: tuple[float, ...]) -> tuple[PaperRow, ...]:
    total, lateral, axial, lateral_again, normal_again, axial_again = estimated
    return (
        PaperRow("total position accuracy", accuracy, "total_m", REQUIRED_TOTAL_M, total),
        PaperRow("lateral position accuracy", accuracy, "lateral_m", REQUIRED_LATERAL_M, lateral),
        PaperRow("axial orientation accuracy", accuracy, "axial_rad", REQUIRED_AXIAL_RAD, axial),
        PaperRow("lateral position repeatability", again, "lateral_m", REPEAT_LATERAL_M, lateral_again),
        PaperRow("normal position repeatability", again, "normal_m", REPEAT_NORMAL_M, normal_again),
        PaperRow("axial orientation repeatability", again, "axial_rad", REPEAT_AXIAL_RAD, axial_again),
    )


TABLE_3: Final = _paper_rows(
    "accuracy", "repeatability", (0.0262, 0.0232, radians(1.2), 0.0112, 0.0072, radians(0.7))
)
"""Before calibration."""
TABLE_4: Final = _paper_rows(
    "mars", "mars-repeatability", (0.0140, 0.0127, radians(1.1), 0.0077, 0.0050, radians(1.0))
)
"""After calibration, on Mars."""


@dataclass(frozen=True, slots=True, eq=False)
class MagnitudeFit:
    """Factors of the magnitudes, with the rows that they give."""

    factor: Mapping[SourcePart, float]
    magnitude: Mapping[SourcePart, tuple[float, str]]
    """Largest changed magnitude of each part, with its unit."""
    rows: tuple[tuple[PaperRow, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Terms:
    """Errors (6, n) of a case by source, with separate terms for the parts that may change."""

    fixed: Mapping[str, Array]
    part: Mapping[SourcePart, Array]
    at_limit: Mapping[str, bool]

    def components(self, factor: Mapping[SourcePart, float]) -> Array:
        """Combine the errors by the paper's rule, shape (6, n)."""
        u = {name: fixed.copy() for name, fixed in self.fixed.items()}
        for (name, part), term in self.part.items():
            u[name] += factor[name, part] * term
        at_limit = np.array([self.at_limit[name] for name in u])
        return paper_rule(np.array(list(u.values()))[:, :, None], at_limit)


def reproduce(
    model: ErrorModel, rows: tuple[PaperRow, ...], config: Config, gravity_R_m_s2: Array, seed: int
) -> MagnitudeFit:
    """Find the magnitudes that reproduce these rows; magnitudes from documents stay unchanged."""
    sensitivity = [
        compute_sensitivity(
            config, workspace_poses(config.arm, tool, gravity_R_m_s2, POSES_A_TOOL, seed), gravity_R_m_s2
        )
        for tool in config.params.tool_names
    ]
    terms = {name: _terms(model, name, sensitivity) for name in {row.case for row in rows}}
    parts = list(dict.fromkeys(part for case in terms.values() for part in case.part))

    def values(x: Array) -> Array:
        factor = dict(zip(parts, np.exp(x), strict=True))
        found = {name: bounds(case.components(factor)) for name, case in terms.items()}
        return np.array([np.quantile(getattr(found[row.case], row.component), COVERAGE) for row in rows])

    targets = np.array([row.estimated for row in rows])
    fit = least_squares(
        lambda x: np.concatenate([np.log(values(x) / targets) / ROW_TOLERANCE, x]), np.zeros(len(parts))
    )
    factor = dict(zip(parts, np.exp(fit.x).tolist(), strict=True))
    return MagnitudeFit(
        factor,
        {part: _magnitude(model.source[part[0]], part[1], factor[part]) for part in parts},
        tuple(zip(rows, values(fit.x).tolist(), strict=True)),
    )


def _terms(model: ErrorModel, name: str, sensitivity: list[Sensitivity]) -> _Terms:
    fixed, part = {}, {}
    sources = model.case[name].sources
    for source, factor in sources.items():
        parts = _parts(model.source[source])
        whole = factor * _over_frames(sensitivity, model.source[source])
        fixed[source] = np.zeros_like(whole) if parts else whole
        for which, only in parts.items():
            part[source, which] = factor * _over_frames(sensitivity, only)
    return _Terms(fixed, part, {source: model.source[source].at_limit for source in sources})


def _over_frames(sensitivity: list[Sensitivity], source: ErrorSource) -> Array:
    return np.concatenate([one.errors_by_frame(source).sum(axis=1) for one in sensitivity], axis=-1)


def _parts(source: ErrorSource) -> dict[str, ErrorSource]:
    """Split a source without a document into rotations and translations, of the arm and of the tool frame.

    A source relative to load or temperature has one part, its share.
    """
    if source.label == "S":
        return {}
    if source.relative_to != "frames":
        return {SHARE: source}
    arm = tuple(frame for frame in Frame if frame is not Frame.TOOL)
    parts = {
        f"{what}, {where}": replace(source, at=_select_frames(source, frames, what))
        for where, frames in (("arm", arm), ("tool frame", (Frame.TOOL,)))
        for what in ("rotation", "translation")
    }
    return {name: part for name, part in parts.items() if part.theta.any()}


def _select_frames(source: ErrorSource, frames: tuple[Frame, ...], what: str) -> tuple[FrameMagnitude, ...]:
    theta = source.theta
    none: Vector3 = (0.0, 0.0, 0.0)
    rows = [
        (
            frame,
            vector3(theta[:3, frame] * 1e3) if what == "rotation" else none,
            vector3(theta[3:, frame] * 1e3) if what == "translation" else none,
        )
        for frame in frames
    ]
    return tuple(FrameMagnitude((frame.name.lower(),), turn, shift) for frame, turn, shift in rows)  # type: ignore[arg-type]


def _magnitude(source: ErrorSource, part: str, factor: float) -> tuple[float, str]:
    if part == SHARE:
        return factor * source.share * 1e2, "%"
    theta = _parts(source)[part].theta
    return float(theta.max() * 1e3 * factor), "mrad" if part.startswith("rotation") else "mm"

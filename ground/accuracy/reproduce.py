"""The magnitudes that would make our budget the paper's: as small a change of the assumed ones as will do."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from fsw.config import Config
from fsw.dictionary.enums import Frame, Tool
from fsw.dictionary.types import Vector3, vector3
from fsw.kinematics.transforms import Array
from ground.accuracy.budget import COVERAGE
from ground.accuracy.combine import bounds, paper_rule
from ground.accuracy.paper import Row
from ground.accuracy.poses import workspace_poses
from ground.accuracy.propagate import Sensitivity, sensitivity
from ground.accuracy.sources import At, ErrorModel, Source

POSES_A_TOOL: Final = 300
CLOSE: Final = 0.01
"""A row that is off by this share counts as much as a magnitude that changes by a factor of e."""

Part = tuple[str, str]
"""Of which source, and which part of its magnitudes."""


@dataclass(frozen=True, slots=True, eq=False)
class Reproduced:
    """By what the magnitudes are multiplied, and what the rows are then."""

    factor: Mapping[Part, float]
    magnitude: Mapping[Part, tuple[float, str]]
    """The largest of each part, as it would be, and its unit."""
    rows: tuple[tuple[Row, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Terms:
    """A case as a sum: errors (6, n) by source, those of its parts apart."""

    fixed: Mapping[str, Array]
    part: Mapping[Part, Array]
    at_limit: Mapping[str, bool]

    def components(self, factor: Mapping[Part, float]) -> Array:
        """By the paper's rule, (6, n)."""
        u = {name: fixed.copy() for name, fixed in self.fixed.items()}
        for (name, part), term in self.part.items():
            u[name] += factor[name, part] * term
        at_limit = np.array([self.at_limit[name] for name in u])
        return paper_rule(np.array(list(u.values()))[:, :, None], at_limit)


def reproduce(
    model: ErrorModel, rows: tuple[Row, ...], config: Config, gravity_R_m_s2: Array, seed: int
) -> Reproduced:
    """The change of magnitudes that meets these rows; sourced magnitudes stay."""
    moved = [
        sensitivity(
            config, workspace_poses(config.arm, tool, gravity_R_m_s2, POSES_A_TOOL, seed), gravity_R_m_s2
        )
        for tool in Tool
    ]
    terms = {name: _terms(model, name, moved) for name in {row.case for row in rows}}
    parts = list(dict.fromkeys(part for case in terms.values() for part in case.part))

    def values(x: Array) -> Array:
        factor = dict(zip(parts, np.exp(x), strict=True))
        found = {name: bounds(case.components(factor)) for name, case in terms.items()}
        return np.array([np.quantile(getattr(found[row.case], row.component), COVERAGE) for row in rows])

    wanted = np.array([row.estimated for row in rows])
    fit = least_squares(
        lambda x: np.concatenate([np.log(values(x) / wanted) / CLOSE, x]), np.zeros(len(parts))
    )
    factor = dict(zip(parts, np.exp(fit.x).tolist(), strict=True))
    return Reproduced(
        factor,
        {part: _magnitude(model.source[part[0]], part[1], factor[part]) for part in parts},
        tuple(zip(rows, values(fit.x).tolist(), strict=True)),
    )


def _terms(model: ErrorModel, name: str, moved: list[Sensitivity]) -> _Terms:
    fixed, part = {}, {}
    sources = model.case[name].sources
    for source, factor in sources.items():
        parts = _parts(model.source[source])
        whole = factor * _over_frames(moved, model.source[source])
        fixed[source] = np.zeros_like(whole) if parts else whole
        for which, only in parts.items():
            part[source, which] = factor * _over_frames(moved, only)
    return _Terms(fixed, part, {source: model.source[source].at_limit for source in sources})


def _over_frames(moved: list[Sensitivity], source: Source) -> Array:
    return np.concatenate([one.by_frame(source).sum(axis=1) for one in moved], axis=-1)


def _parts(source: Source) -> dict[str, Source]:
    """A source that is not from a document, in parts: turns and shifts, of the arm and of the tool frame."""
    if source.of != "frames" or source.label == "S":
        return {}
    arm = tuple(frame for frame in Frame if frame is not Frame.TOOL)
    parts = {
        f"{what}, {where}": replace(source, at=_some_of(source, frames, what))
        for where, frames in (("arm", arm), ("tool frame", (Frame.TOOL,)))
        for what in ("rotation", "translation")
    }
    return {name: part for name, part in parts.items() if part.theta.any()}


def _some_of(source: Source, frames: tuple[Frame, ...], what: str) -> tuple[At, ...]:
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
    return tuple(At((frame.name.lower(),), turn, shift) for frame, turn, shift in rows)  # type: ignore[arg-type]


def _magnitude(source: Source, part: str, factor: float) -> tuple[float, str]:
    theta = _parts(source)[part].theta
    return float(theta.max() * 1e3 * factor), "mrad" if part.startswith("rotation") else "mm"

"""What is left of the turret's screws, as millimetres at the tools."""

from collections.abc import Sequence

import numpy as np

from fsw.config import configure
from fsw.kinematics.transforms import Array, skew
from ground.diagnosis.layout import Ints
from ground.diagnosis.result import ToolGap
from sim.params import nominal_params
from sim.plant import SCREW_AXES


def tool_gap(keys: Sequence[str], before: Array, after: Array, sigma: Array) -> ToolGap | None:
    """Root mean squares over rests and tools of features (m,) with these keys; None without whole screws.

    A turret that is off by a turn w and a shift v has its tool, p away, off by v + w x p. `sigma` (m,) is
    the floor.
    """
    rows = _screws(keys)
    if not rows.size:
        return None
    tools = configure(nominal_params()).arm.X_FT
    J = np.stack([np.hstack([-skew(X.p[:, None])[:, :, 0], np.eye(3)]) for X in tools])  # (tools, 3, 6)
    squares = [np.mean(np.sum(np.einsum("tij,rj->rti", J, of[rows]) ** 2, axis=2)) for of in (before, after)]
    floor = np.mean(np.einsum("tij,rj->rt", J**2, sigma[rows] ** 2))
    return ToolGap(*(float(1e3 * np.sqrt(one)) for one in (*squares, floor)))


def _screws(keys: Sequence[str]) -> Ints:
    """Rows of all six numbers of each rest that has them, (r, 6)."""
    known: dict[str, dict[str, int]] = {}
    for row, key in enumerate(keys):
        rest, _, axis = key.rpartition("/")
        known.setdefault(rest, {})[axis] = row
    whole = [[one[axis] for axis in SCREW_AXES] for one in known.values() if one.keys() >= set(SCREW_AXES)]
    return np.array(whole, np.intp).reshape(-1, len(SCREW_AXES))

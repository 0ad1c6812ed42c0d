"""Targets in the rover frame, made from what people give, and checked one by one."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array
from ground.common.requests import FARTHEST_M, SHORTEST, WORKSPACE, BadRequest, numbers
from sim.frames import p_R_from_N

FRAMES: Final = ("rnav", "rmech")

Naming = Callable[[int], tuple[str, str]]
"""What the position and the approach of a target are called, by its number."""


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Where the tool's origin is to be and along which direction its boresight, in RMECH."""

    p_RoTo_R_m: Array
    """(3, n)."""
    approach_R: Array
    """(3, n), of length 1."""

    def __len__(self) -> int:
        return int(self.p_RoTo_R_m.shape[1])

    def part(self, start: int, count: int) -> "Targets":
        """Some of them, from number `start` on."""
        these = slice(start, start + count)
        return Targets(self.p_RoTo_R_m[:, these], self.approach_R[:, these])


def checked_targets(position_m: Array, approach: Array, frame: str, naming: Naming) -> Targets:
    """Targets from positions (3, n) in `frame` and directions (3, n) of any length; its axes are the rover's.

    Raises:
        BadRequest: no such frame, numbers that are not finite, a point far away, or no direction.
    """
    if frame not in FRAMES:
        raise BadRequest(f"frame: {frame!r} is not known; there are {', '.join(FRAMES)}")
    for which, values in enumerate((position_m, approach)):
        _refuse(~np.isfinite(values).all(axis=0), values, naming, which, "is not three finite numbers")
    with np.errstate(over="ignore"):
        distance = np.hypot(np.hypot(position_m[0], position_m[1]), position_m[2])
    _refuse(
        distance > FARTHEST_M,
        position_m,
        naming,
        0,
        f"m is farther than {FARTHEST_M:g} m from the rover; {WORKSPACE}",
    )
    largest = np.abs(approach).max(axis=0)
    _refuse(
        largest < SHORTEST,
        approach,
        naming,
        1,
        "has no direction; give the one in which the tool is to point, such as 0 0 1 for down",
    )
    unit = approach / largest  # first, so that the length is a number
    unit = unit / np.linalg.norm(unit, axis=0)
    return Targets(p_R_from_N(position_m.T).T if frame == "rnav" else position_m, unit)


def _refuse(wrong: NDArray[np.bool_], values: Array, naming: Naming, which: int, complaint: str) -> None:
    if not wrong.any():
        return
    first = int(np.argmax(wrong))
    said = numbers(tuple(float(value) for value in values[:, first]))
    raise BadRequest(f"{naming(first)[which]}: {said} {complaint}")

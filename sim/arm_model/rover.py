"""Rover of an arm: its hull, and the frame in which the file of the arm gives positions on the rover."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from fsw.dictionary.params import Transform6
from fsw.dictionary.types import Vector3, vector3
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array
from sim.arm_model.description import ArmDescription, Hull, RoverDescription, Shape
from sim.frames import P_NR_M
from simgap.common.toml import read_toml


@cache
def default_rover(path: Path) -> RoverDescription:
    """Read the rover of the arms whose file gives none."""
    return TypeAdapter(RoverDescription).validate_python(read_toml(path))


def on_rover(arm: ArmDescription, rover: RoverDescription) -> tuple[ArmDescription, Hull]:
    """Convert what an arm and its rover have in frame V to RMECH.

    RMECH is at the same place on every rover, so that all that reads it can take any arm.
    """
    shift_m = np.array(rover.p_NoVo_N_m) - P_NR_M
    if not shift_m.any():
        return arm, rover.hull

    def moved(p_m: Vector3) -> Vector3:
        return vector3(np.array(p_m) + shift_m)

    hull = {
        part: tuple(move_shape(shape, shift_m) for shape in shapes) for part, shapes in rover.hull.items()
    }
    base = arm.links.arm1
    base = replace(
        base,
        transform=_move_end(base.transform, shift_m),
        elastic_centre_m=moved(base.elastic_centre_m),
        far=replace(base.far, com_m=moved(base.far.com_m)),
    )
    teach = tuple(replace(point, p_RoTo_R_m=moved(point.p_RoTo_R_m)) for point in arm.teach)
    return replace(arm, links=replace(arm.links, arm1=base), teach=teach), hull


def move_shape(shape: Shape, shift_m: Array) -> Shape:
    """Return a shape at another place, rounded to a picometre."""
    given = {name: getattr(shape, name) for name in ("from_m", "to_m", "centre_m")}
    moved: dict[str, Any] = {
        name: vector3(np.round(p + shift_m, 12)) for name, p in given.items() if p is not None
    }
    return replace(shape, **moved)


def _move_end(X: Transform6, shift_m: Array) -> Transform6:
    """Return a transform with the same turn, whose end is shifted in the axes of its start."""
    axes = [
        transform6_to_pose(Transform6(theta_rad=X.theta_rad, beta_rad=X.beta_rad, **{name: 1.0})).p
        for name in ("d_m", "b_m", "a_m")
    ]
    d_m, b_m, a_m = np.linalg.solve(np.column_stack(axes), transform6_to_pose(X).p + shift_m)
    return replace(X, d_m=float(d_m), b_m=float(b_m), a_m=float(a_m))

"""Functions that read and change flight parameters of one joint or link."""

from dataclasses import replace

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import JointParams, LinkParams, Params
from fsw.dictionary.types import Matrix6, row6
from fsw.kinematics.transforms import Array


def joint_of(params: Params, joint: Joint) -> JointParams:
    """Return the flight parameters of a joint."""
    found: JointParams = getattr(params.joints, joint.name.lower())
    return found


def with_joint(params: Params, joint: Joint, changed: JointParams) -> Params:
    """Return the parameters with those of one joint replaced."""
    return replace(params, joints=replace(params.joints, **{joint.name.lower(): changed}))


def link_of(params: Params, frame: Frame) -> LinkParams:
    """Return the flight parameters of the link that ends in a frame other than TOOL."""
    found: LinkParams = getattr(params.links, frame.name.lower())
    return found


def with_link(params: Params, frame: Frame, changed: LinkParams) -> Params:
    """Return the parameters with those of one link replaced."""
    return replace(params, links=replace(params.links, **{frame.name.lower(): changed}))


def scale_matrix(matrix: Matrix6, factor: float) -> Matrix6:
    """Multiply every element by a factor."""
    return _matrix6(np.array(matrix) * factor)


def rotate_matrix(matrix: Matrix6, R: Array) -> Matrix6:
    """Rotate a matrix for screws by R: its rotation and its translation parts."""
    R6 = np.zeros((6, 6))
    R6[:3, :3] = R6[3:, 3:] = R
    return _matrix6(R6 @ np.array(matrix) @ R6.T)


def add_compliance(matrix: Matrix6, axis: int, added: float) -> Matrix6:
    """Add a compliance to one element of the diagonal."""
    values = np.array(matrix)
    values[axis, axis] += added
    return _matrix6(values)


def _matrix6(values: Array) -> Matrix6:
    a, b, c, d, e, f = (row6(row) for row in values.tolist())
    return (a, b, c, d, e, f)

"""Functions that read and change flight parameters of one joint or link."""

from dataclasses import replace

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import JointParams, LinkParams, Params
from fsw.dictionary.types import Matrix6, row6
from fsw.kinematics.transforms import Array


def joint_of(params: Params, joint: Joint) -> JointParams:
    """What flight software is told of a joint."""
    found: JointParams = getattr(params.joints, joint.name.lower())
    return found


def with_joint(params: Params, joint: Joint, changed: JointParams) -> Params:
    """The parameters with another joint."""
    return replace(params, joints=replace(params.joints, **{joint.name.lower(): changed}))


def link_of(params: Params, frame: Frame) -> LinkParams:
    """What flight software is told of the link that ends in a frame, which is not that of a tool."""
    found: LinkParams = getattr(params.links, frame.name.lower())
    return found


def with_link(params: Params, frame: Frame, changed: LinkParams) -> Params:
    """The parameters with another link."""
    return replace(params, links=replace(params.links, **{frame.name.lower(): changed}))


def scale_matrix(matrix: Matrix6, factor: float) -> Matrix6:
    """Every element times a factor."""
    return _matrix6(np.array(matrix) * factor)


def rotate_matrix(matrix: Matrix6, R: Array) -> Matrix6:
    """The same spring seen from axes turned back by R: both its rotations and its translations turn."""
    both = np.kron(np.eye(2), R)
    return _matrix6(both @ np.array(matrix) @ both.T)


def add_compliance(matrix: Matrix6, axis: int, more: float) -> Matrix6:
    """More on one place of the diagonal."""
    values = np.array(matrix)
    values[axis, axis] += more
    return _matrix6(values)


def _matrix6(values: Array) -> Matrix6:
    a, b, c, d, e, f = (row6(row) for row in values)
    return (a, b, c, d, e, f)

"""Distances of segments and boxes, compared with sampled points, with MuJoCo and with swapped arguments."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.collision.distance import box_distance, edges_distance, point_distance, segment_distance
from fsw.kinematics.transforms import Pose, inverse, screw_exp

ALONG = np.linspace(0.0, 1.0, 2001)
coordinates = hnp.arrays(float, 3, elements=st.floats(-2, 2).map(lambda x: round(x, 9)))
halves = hnp.arrays(float, 3, elements=st.floats(0, 1))
screws = hnp.arrays(float, 6, elements=st.floats(-3, 3))


def one(v):
    return v[:, None]


@given(coordinates, coordinates, halves)
def test_a_segment_is_as_far_from_a_box_as_the_nearest_of_its_points(p, along, half):
    points = p[:, None] + along[:, None] * ALONG
    nearest = point_distance(points, one(half)).min()
    found = segment_distance(one(p), one(along), one(half))[0]
    assert found <= nearest + 1e-12
    assert found >= nearest - 0.5 * np.linalg.norm(along) / (ALONG.size - 1) - 1e-12


@given(coordinates, coordinates, coordinates, coordinates)
def test_two_segments_are_as_far_apart_either_way_round(p, along, other_p, other_along):
    """A segment is a box about its middle with a length only."""
    X = [segment_pose(p, along), segment_pose(other_p, other_along)]
    half = [one(np.array([0.5 * np.linalg.norm(v), 0, 0])) for v in (along, other_along)]
    X_AB = inverse(X[0]) @ X[1]
    here = edges_distance(X_AB, half[1], half[0], edges=1)[0]
    there = edges_distance(inverse(X_AB), half[0], half[1], edges=1)[0]
    assert here == pytest.approx(there, abs=1e-9)


def segment_pose(p, along):
    length = np.linalg.norm(along)
    x = along / length if length > 0 else np.array([1.0, 0, 0])
    y = np.cross(np.eye(3)[np.abs(x).argmin()], x)
    y /= np.linalg.norm(y)
    R = np.column_stack([x, y, np.cross(x, y)])
    return Pose(R[..., None], one(p + 0.5 * along))


@given(screws, halves, halves)
def test_boxes_are_as_far_apart_either_way_round_and_no_farther_than_any_two_of_their_points(
    screw, half_A, half_B
):
    X_AB = screw_exp(one(screw))
    here = box_distance(X_AB, one(half_A), one(half_B))[0]
    assert here == pytest.approx(box_distance(inverse(X_AB), one(half_B), one(half_A))[0], abs=1e-12)
    inside = np.random.default_rng(7).uniform(-1, 1, (3, 500)) * half_B[:, None]
    assert here <= point_distance(X_AB.R[..., 0] @ inside + X_AB.p, one(half_A)).min() + 1e-12


def test_boxes_are_as_far_apart_as_mujoco_says():
    rng = np.random.default_rng(11)
    compared = 0
    for _ in range(150):
        half_A, half_B, screw = rng.uniform(0.05, 0.6, 3), rng.uniform(0.05, 0.6, 3), rng.normal(size=6)
        X_AB = screw_exp(one(screw))
        apart = mujoco_distance(half_A, half_B, X_AB)
        found = box_distance(X_AB, one(half_A), one(half_B))[0]
        assert found == pytest.approx(max(apart, 0.0), abs=2e-6)
        compared += apart > 0
    assert compared > 50


def mujoco_distance(half_A, half_B, X_AB):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half_A)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, X_AB.R[..., 0].ravel())
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(type=box, size=half_B, pos=X_AB.p[:, 0], quat=quaternion)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return mujoco.mj_geomDistance(model, data, 0, 1, 100.0, None)


def test_a_box_that_is_run_through_by_a_long_one_is_met():
    """No edge of the wide box and no corner of either box is inside the other."""
    wide, long = one(np.array([1.0, 1.0, 0.1])), one(np.array([0.05, 0.05, 3.0]))
    X = screw_exp(one(np.array([0.02, 0.01, 0.3, 0.0, 0.0, 0.0])))
    assert box_distance(X, wide, long)[0] == 0.0
    assert box_distance(inverse(X), long, wide)[0] == 0.0

"""Rotations, poses and screws obey the laws of their groups, single and in batches."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.linalg import expm

from fsw.kinematics import transforms
from tests.fsw.rig import matrix

screws = hnp.arrays(float, 6, elements=st.floats(-3, 3))
angles = st.floats(-10, 10).map(np.array)
vectors = hnp.arrays(float, 3, elements=st.floats(-5, 5))
BATCH = (4, 7)


def hat(screw):
    X = np.zeros((4, 4))
    X[:3, :3], X[:3, 3] = transforms.skew(screw[:3]), screw[3:]
    return X


def assert_same(X, Y, atol):
    np.testing.assert_allclose(X.R, Y.R, atol=atol)
    np.testing.assert_allclose(X.p, Y.p, atol=atol)


@given(screws, screws)
def test_a_product_of_poses_is_the_product_of_their_matrices(a, b):
    A, B = transforms.screw_exp(a), transforms.screw_exp(b)
    np.testing.assert_allclose(matrix(A @ B), matrix(A) @ matrix(B), atol=1e-14)


@given(screws)
def test_inverse_undoes_on_either_side(s):
    X = transforms.screw_exp(s)
    assert_same(transforms.inverse(X) @ X, transforms.IDENTITY, atol=1e-12)
    assert_same(X @ transforms.inverse(X), transforms.IDENTITY, atol=1e-12)
    assert_same(transforms.inverse(X), transforms.screw_exp(-s), atol=1e-12)


@given(screws, st.floats(0, 1))
def test_screw_exp_is_the_matrix_exponential(s, scale):
    for small in (scale, 1e-2 * scale, 1e-6 * scale, 0.0):
        np.testing.assert_allclose(matrix(transforms.screw_exp(small * s)), expm(hat(small * s)), atol=1e-12)


def test_screw_exp_has_no_step_where_its_series_takes_over():
    axis = np.array([0.6, -0.48, 0.64, 0.3, -0.2, 0.5])
    for angle in (0.00999, 0.0099999999, 0.01, 0.0100000001, 0.01001):
        np.testing.assert_allclose(
            matrix(transforms.screw_exp(angle * axis)), expm(hat(angle * axis)), atol=1e-15
        )


@given(angles)
def test_rotations_are_exponentials_of_their_axes(angle):
    for axis, turn in enumerate((transforms.rotation_x, transforms.rotation_y, transforms.rotation_z)):
        np.testing.assert_allclose(turn(angle), expm(transforms.skew(angle * np.eye(3)[axis])), atol=1e-12)


@given(vectors, vectors)
def test_vector_products_are_numpy_s(p, v):
    np.testing.assert_allclose(transforms.skew(p) @ v, np.cross(p, v), atol=1e-12)
    np.testing.assert_allclose(transforms.cross(p, v), np.cross(p, v), atol=1e-12)
    np.testing.assert_allclose(transforms.dot(p, v), p @ v, atol=1e-12)
    np.testing.assert_allclose(transforms.norm(p), np.linalg.norm(p), rtol=1e-14, atol=1e-150)


@given(screws, vectors)
def test_turning_back_undoes_turning(s, v):
    R = transforms.screw_exp(s).R
    np.testing.assert_allclose(transforms.rotate(R, v), R @ v, atol=1e-13)
    np.testing.assert_allclose(transforms.rotate_back(R, transforms.rotate(R, v)), v, atol=1e-12)


@given(screws, screws)
def test_adjoint_carries_a_screw_as_conjugation_does(x, s):
    X = transforms.screw_exp(x)
    np.testing.assert_allclose(
        hat(transforms.adjoint(X) @ s), matrix(X) @ hat(s) @ matrix(transforms.inverse(X)), atol=1e-10
    )


def many(rows, seed):
    return np.random.default_rng(seed).uniform(-3, 3, (rows, *BATCH))


@pytest.mark.parametrize(
    "function",
    [
        lambda s, t: transforms.screw_exp(s).R,
        lambda s, t: transforms.screw_exp(s).p,
        lambda s, t: transforms.screw_exp(1e-3 * s).p,
        lambda s, t: transforms.adjoint(transforms.screw_exp(s)),
        lambda s, t: transforms.inverse(transforms.screw_exp(s)).p,
        lambda s, t: (transforms.screw_exp(s) @ transforms.screw_exp(t)).R,
        lambda s, t: (transforms.screw_exp(s) @ transforms.screw_exp(t)).p,
        lambda s, t: transforms.compose(transforms.rotation_x(s[0]), transforms.rotation_y(t[0])),
        lambda s, t: transforms.rotate_back(transforms.rotation_z(s[0]), t[:3]),
        lambda s, t: transforms.cross(s[:3], t[:3]),
        lambda s, t: transforms.norm(s),
        lambda s, t: transforms.skew(s[:3]),
    ],
)
def test_a_batch_is_its_single_cases(function):
    s, t = many(6, 1), many(6, 2)
    batch = function(s, t)
    for index in np.ndindex(BATCH):
        where = (slice(None), *index)
        np.testing.assert_allclose(batch[(..., *index)], function(s[where], t[where]), rtol=0, atol=4e-15)


def test_poses_of_a_batch_are_taken_by_the_index_of_the_batch_and_made_one_again():
    X = transforms.screw_exp(many(6, 3))
    for index in ((2, 5), 3, (slice(None), 1), (Ellipsis, 0)):
        where = index if isinstance(index, tuple) else (index,)
        np.testing.assert_array_equal(X[index].R, X.R[(slice(None), slice(None), *where)])
        np.testing.assert_array_equal(X[index].p, X.p[(slice(None), *where)])
    again = transforms.stack_poses([X[index] for index in np.ndindex(BATCH)])
    for k, index in enumerate(np.ndindex(BATCH)):
        assert_same(again[k], X[index], atol=0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 3.0, np.pi - 1e-9, np.pi])
def test_the_angle_between_two_vectors_is_that_of_the_turn_between_them(angle):
    axis, across = np.array([1.0, -2.0, 2.0]) / 3, np.array([2.0, 2.0, 1.0])
    turned = transforms.screw_exp(np.concatenate([angle * axis, np.zeros(3)])).R @ across
    assert transforms.angle_between(across, 5 * turned) == pytest.approx(angle, abs=4e-15)


@given(st.floats(-1e3, 1e3))
@example(np.pi)
@example(-np.pi)
def test_wrap_gives_the_same_angle_within_half_a_turn(angle):
    wrapped = transforms.wrap_angle(np.array(angle))
    assert -np.pi <= wrapped < np.pi
    turns = (angle - wrapped) / (2 * np.pi)
    assert abs(turns - round(turns)) < 1e-10

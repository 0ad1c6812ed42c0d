"""Rotations, transforms and screws obey the laws of their groups."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.linalg import expm

from fsw.kinematics.transforms import (
    adjoint,
    inverse,
    rigid,
    rotation_x,
    rotation_y,
    rotation_z,
    screw_exp,
    skew,
    translation,
    wrap_angle,
)

screws = hnp.arrays(float, 6, elements=st.floats(-3, 3))
angles = st.floats(-10, 10).map(np.array)
vectors = hnp.arrays(float, 3, elements=st.floats(-5, 5))


def hat(screw):
    X = np.zeros((4, 4))
    X[:3, :3], X[:3, 3] = skew(screw[:3]), screw[3:]
    return X


def log_near_identity(X):
    R = X[:3, :3]
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], *(2 * X[:3, 3])]) / 2


@given(screws, screws, screws)
def test_transforms_associate_and_stay_rigid(a, b, c):
    A, B, C = screw_exp(a), screw_exp(b), screw_exp(c)
    np.testing.assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-12)
    R = (A @ B)[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.isclose(np.linalg.det(R), 1.0)


@given(screws)
def test_inverse_undoes_on_either_side(s):
    X = screw_exp(s)
    np.testing.assert_allclose(inverse(X) @ X, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(X @ inverse(X), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(inverse(X), screw_exp(-s), atol=1e-12)


@given(screws, st.floats(0, 1))
def test_screw_exp_is_the_matrix_exponential(s, scale):
    for small in (scale, 1e-2 * scale, 1e-6 * scale, 0.0):
        np.testing.assert_allclose(screw_exp(small * s), expm(hat(small * s)), atol=1e-12)


def test_screw_exp_has_no_step_where_its_series_takes_over():
    axis = np.array([0.6, -0.48, 0.64, 0.3, -0.2, 0.5])
    for angle in (0.00999, 0.0099999999, 0.01, 0.0100000001, 0.01001):
        np.testing.assert_allclose(screw_exp(angle * axis), expm(hat(angle * axis)), atol=1e-15)


@given(screws, st.floats(-1, 1), st.floats(-1, 1))
def test_following_a_screw_for_two_times_adds_the_times(s, t, u):
    np.testing.assert_allclose(screw_exp(t * s) @ screw_exp(u * s), screw_exp((t + u) * s), atol=1e-11)


@given(angles, angles)
def test_turns_about_one_axis_add(a, b):
    for turn in (rotation_x, rotation_y, rotation_z):
        np.testing.assert_allclose(turn(a) @ turn(b), turn(a + b), atol=1e-12)


@given(angles)
def test_rotations_are_exponentials_of_their_axes(angle):
    for axis, turn in enumerate((rotation_x, rotation_y, rotation_z)):
        np.testing.assert_allclose(turn(angle), expm(skew(angle * np.eye(3)[axis])), atol=1e-12)


@given(vectors, vectors)
def test_skew_is_the_cross_product(p, v):
    np.testing.assert_allclose(skew(p) @ v, np.cross(p, v), atol=1e-12)


@given(screws, screws)
def test_adjoint_carries_a_screw_as_conjugation_does(x, s):
    X = screw_exp(x)
    np.testing.assert_allclose(hat(adjoint(X) @ s), X @ hat(s) @ inverse(X), atol=1e-10)


@given(screws, screws)
def test_adjoint_agrees_with_finite_differences(x, s):
    X, h = screw_exp(x), 1e-5
    forth = log_near_identity(X @ screw_exp(h * s) @ inverse(X))
    back = log_near_identity(X @ screw_exp(-h * s) @ inverse(X))
    np.testing.assert_allclose((forth - back) / (2 * h), adjoint(X) @ s, atol=1e-7)


@given(screws, screws)
def test_adjoint_of_a_product_is_the_product_of_adjoints(a, b):
    A, B = screw_exp(a), screw_exp(b)
    np.testing.assert_allclose(adjoint(A @ B), adjoint(A) @ adjoint(B), atol=1e-10)


def test_a_batch_is_its_single_cases():
    many = np.random.default_rng(1).uniform(-3, 3, (4, 7, 6))
    for function in (screw_exp, lambda s: adjoint(screw_exp(s)), lambda s: inverse(screw_exp(s))):
        batch = function(many)
        for index in np.ndindex(4, 7):
            np.testing.assert_array_equal(batch[index], function(many[index]))


@given(vectors)
def test_a_translation_only_translates(p):
    np.testing.assert_array_equal(translation(p), rigid(np.eye(3), p))
    np.testing.assert_array_equal(translation(p) @ np.array([0, 0, 0, 1.0]), [*p, 1.0])


@given(st.floats(-1e3, 1e3))
def test_wrap_gives_the_same_angle_within_half_a_turn(angle):
    wrapped = wrap_angle(np.array(angle))
    assert -np.pi <= wrapped < np.pi
    turns = (angle - wrapped) / (2 * np.pi)
    assert abs(turns - round(turns)) < 1e-10


def test_half_a_turn_wraps_to_the_negative_end():
    assert wrap_angle(np.array(np.pi)) == -np.pi
    assert wrap_angle(np.array(-np.pi)) == -np.pi

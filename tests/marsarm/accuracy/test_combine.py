"""Combination rules: the paper's equations, and the rule from moments."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from marsarm.accuracy.propagation import (
    Bounds,
    bounds,
    moments_rule,
    paper_rule,
    root_sum_square,
    shares,
    squared_length,
    worst_case,
)

ERRORS = arrays(np.float64, (4, 6, 7, 2), elements=st.floats(0.0, 1e-2))
AT_LIMIT = np.array([True, False, True, False])


@settings(max_examples=50, deadline=None)
@given(ERRORS)
def test_the_paper_rule_lies_between_the_best_and_the_worst_case(u):
    assert np.all(root_sum_square(u) <= paper_rule(u, AT_LIMIT) + 1e-15)
    assert np.all(paper_rule(u, AT_LIMIT) <= worst_case(u) + 1e-15)


@settings(max_examples=50, deadline=None)
@given(ERRORS)
def test_shares_add_up_to_the_total(u):
    total = bounds(paper_rule(u, AT_LIMIT)).total_m
    there = total > 1e-9
    assert np.allclose(shares(u, AT_LIMIT).sum(axis=(0, 1))[there], total[there], rtol=1e-9)


def test_the_paper_rule_adds_frames_then_roots_sources_then_adds_those_at_their_limits():
    u = np.zeros((4, 6, 7, 1))
    u[0, 3, :2] = [[1.0], [2.0]]
    u[1, 3, 0], u[2, 3, 0], u[3, 3, 0] = 3.0, 5.0, 4.0
    assert paper_rule(u, AT_LIMIT)[3, 0] == pytest.approx(1 + 2 + 5 + np.hypot(3, 4))


def test_nothing_makes_up_nothing():
    u = np.zeros((4, 6, 7, 3))
    u[0, 3, 0, 0] = 1e-3
    assert np.all(np.isfinite(shares(u, AT_LIMIT)[..., 0]))


def test_lateral_is_across_the_approach_and_normal_along_it():
    found = bounds(np.array([[9.0], [0.3], [0.4], [2.0], [3.0], [4.0]]))
    assert (found.normal_m[0], found.lateral_m[0]) == (2.0, 5.0)
    assert found.total_m[0] == pytest.approx(np.sqrt(29))
    assert found.axial_rad[0] == 0.5


def test_ours_is_never_more_than_the_worst_case():
    u = np.zeros((3, 1, 1))
    u[0] = 2.0
    length = squared_length([(u, "uniform")])
    worst = Bounds(*np.full((4, 1), 2.0))
    assert length.quantile(0.9973)[0] > 2.0
    assert moments_rule([length] * 4, worst, 0.9973).total_m.tolist() == [2.0]

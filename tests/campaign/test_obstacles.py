"""Obstacles in the way of free moves are reported as what they are."""

import pytest

from helpers.marks import slow_but
from validation.obstacles import STRAIGHT_N, draw, meet

STRAIGHT = (10, 31, 34)
TURNS = (1, 8, 24)


@pytest.mark.parametrize("index", slow_but(STRAIGHT, 10))
def test_an_obstacle_in_a_straight_move_is_reported_below_50_newtons(index):
    met = meet(0, index)
    assert met.reported, met.report
    assert met.kind == "line"
    assert met.true_N <= STRAIGHT_N


def test_turns_and_straight_moves_are_among_the_first_four():
    assert {draw(0, index, 0).kind for index in range(4)} == {"AZIMUTH", "line"}


@pytest.mark.parametrize("index", slow_but(TURNS, 24))
def test_an_obstacle_in_a_turn_is_reported_with_joint_and_torque(index):
    met = meet(0, index)
    assert met.report.startswith("unexpected contact: ")
    assert met.reported
    assert met.true_N < 154.0  # docs/faults.md, at a lever of 1 m

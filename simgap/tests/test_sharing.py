"""Sharing of simulations: what may stand in one candidate, and what is judged at all joints."""

from collections.abc import Sequence

import numpy as np
import pytest

from helpers.toy import BASE, CATALOGUE, NAMES, ToyResiduals, draw_toy
from simgap.arrays import Array
from simgap.effects.effect import Effect
from simgap.selection.selection import select_effects
from simgap.selection.sharing import ALL_JOINTS, Sharing, find_sharing, relative_reach, share_nothing

NONE = np.empty(0, np.int64)


class Leaking(ToyResiduals):
    """The squares at the first joint move the second three times as much."""

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        rows = super().residuals(effects, sizes).reshape(-1, *self.commands.shape)
        for k, effect in enumerate(effects):
            if effect.key == "near: square":
                rows[:, 1] -= 3.0 * sizes[:, k, None, None] * np.square(self.commands[0])
        return rows.reshape(len(rows), -1)


def test_each_point_stands_in_one_candidate_and_no_joint_twice() -> None:
    rng = np.random.default_rng(1)
    sharing = Sharing(((0, 2), (1,)), np.array([3]), NONE, np.zeros(4, np.int64))
    points = [(int(joint), rng.integers(0, 2, 4) * 1.0) for joint in rng.integers(-1, 3, 60)]
    plan = sharing.plan(points)
    assert sorted(k for members in plan for k in members) == list(range(60))
    for members in plan:
        joints = [points[k][0] for k in members]
        assert len(set(joints)) == len(joints)
        assert set(joints) in ({ALL_JOINTS}, {0}, {1}, {2}, {0, 2})
        assert len({points[k][1][3] for k in members}) == 1  # a size that moves both is the same


def test_without_sharing_each_point_is_a_candidate() -> None:
    points = [(k % 3, np.zeros(2)) for k in range(9)]
    assert len(share_nothing(3, NONE).plan(points)) == 9
    assert len(Sharing(((0, 1, 2),), NONE, NONE, NONE).plan(points)) == 3


@pytest.mark.parametrize(("other", "groups"), [(0.05, ((0, 1),)), (0.2, ((0,), (1,)))])
def test_joints_share_if_their_base_parameters_scarcely_move_one_another(
    other: float, groups: tuple[tuple[int, ...], ...]
) -> None:
    reach = np.array([[2.0, 2.0 * other], [0.0, 1.0]])
    columns = [np.array([0]), np.array([1])]
    assert find_sharing([0, 1], columns, np.array([True, True]), reach, np.arange(2)).groups == groups


def test_an_effect_that_moves_another_joint_of_its_group_does_not_share() -> None:
    reach = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.3]])
    columns = [np.array([k]) for k in range(3)]
    sharing = find_sharing([0, 1, 0], columns, np.array([True, True, False]), reach, np.arange(3))
    assert sharing.groups == ((0, 1),)
    np.testing.assert_array_equal(sharing.mixing, [2])


def test_sizes_differ_in_one_candidate_only_at_joints_that_do_not_move_one_another() -> None:
    sharing = Sharing(((0, 1), (2,)), np.array([4]), NONE, np.array([0, 1, 2, ALL_JOINTS, 1]))
    allowed = {(a, b) for a in range(5) for b in range(5) if sharing.may_share(a, b)}
    assert allowed == {(0, 1), (1, 0)}


def test_reach_is_relative_to_the_joint_itself() -> None:
    np.testing.assert_allclose(relative_reach(1, np.array([1.0, 2.0, 4.0])), [0.5, 0.0, 2.0])


def test_an_effect_at_a_joint_that_moves_another_is_found_by_what_it_does_there() -> None:
    quiet = draw_toy(3, {"near: square": 0.02})
    quiet.measured[1] += 3.0 * 0.02 * np.square(quiet.commands[0])
    model = Leaking(quiet.commands, quiet.measured, NAMES)
    selection = select_effects(model, BASE, CATALOGUE, seed=1)
    assert [selection.context.joint_of(one) for one in selection.chosen.effects] == [ALL_JOINTS]
    assert [one.key for one in selection.chosen.effects] == ["near: square"]
    (column,) = selection.context.union.columns(selection.chosen.effects)
    assert selection.chosen.sizes[column] == pytest.approx(0.02, rel=0.2)

"""A fit begins where the screening of an effect leads."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from helpers.toy import NAMES, Toy, ToyResiduals
from simgap.effects.effect import Size
from simgap.selection.fit import JointFit, Union
from simgap.selection.screening import list_trials, score_effect, whiten

X = np.linspace(-1.0, 1.0, 50)


@dataclass(frozen=True)
class Shaped(Toy):
    """Effect with a form, which means nothing while its amplitude is 0."""

    has_shape: ClassVar[bool] = True

    @property
    def sizes(self) -> tuple[Size, ...]:
        return (Size("amplitude", -5.0, 5.0, 1.0), Size("form", 0.0, 5.0, 2.0))


@dataclass(frozen=True)
class Limit(Toy):
    """Effect that nothing reaches while it is small."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        return (Size("inverse", 0.0, 5.0, 1.0),)


def start(effect: Toy, amplitude: float, silent_below: float = 0.0) -> list[float]:
    """Return the start of a fit to residuals that an effect of this amplitude leaves."""
    commands = np.tile(X, (len(NAMES), 4, 1))
    model, union = ToyResiduals(commands, 0.0 * commands, NAMES), Union((effect,))
    rows = np.flatnonzero(model.joint_of == 0)
    change = np.square(commands).ravel()[rows]
    fit = JointFit(np.zeros(2), np.empty(0, np.int64), 0, amplitude * change, rows, np.empty((rows.size, 0)))
    at = np.zeros(len(effect.sizes))
    trials = list_trials(union, effect, at)
    sizes = [float(trial.points[0][0]) for trial in trials]
    changes = [-(size if abs(size) > silent_below else 0.0) * change[:, None] for size in sizes]
    score, *_ = score_effect(whiten([fit], model, np.ones(2)), trials, changes, at)
    return [float(size) for size in score.start]


@pytest.mark.parametrize("amplitude", [0.1, 0.2, -0.25])
def test_a_fit_of_a_small_effect_begins_at_its_size(amplitude: float) -> None:
    assert start(Toy("near", "square", np.square), amplitude) == pytest.approx([amplitude])


def test_the_form_of_an_effect_is_not_scaled_with_its_amplitude() -> None:
    assert start(Shaped("near", "square", np.square), 0.2) == pytest.approx([0.2, 2.0])


def test_a_fit_begins_no_nearer_to_0_than_a_third_of_a_size_that_was_tried() -> None:
    assert start(Toy("near", "square", np.square), 1e-3) == pytest.approx([0.09])


@pytest.mark.parametrize(("silent_below", "first"), [(0.0, 0.2), (0.5, 1.0), (2.0, 3.0)])
def test_a_fit_of_a_limit_begins_at_a_size_that_changes_something(silent_below: float, first: float) -> None:
    assert start(Limit("near", "limit", np.square), 0.2, silent_below) == pytest.approx([first])

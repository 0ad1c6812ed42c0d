"""The interface between the selection of effects and the three kinds of residual.

Forward simulation, inverse dynamics and a second encoder each predict what the logs say, for many candidates
at once. Selection, fit and verdict know no more of them than this.
"""

from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect

SECOND_ENCODER: Final = "second encoder"
"""Kind of the residual between two encoders."""


class ResidualModel(Protocol):
    """Predict measured minus predicted values for candidates: sets of effects with their sizes."""

    kind: str
    """"simulation", "inverse dynamics", "second encoder" or "tracker"."""
    unit: str
    """Unit of the residuals."""
    joints: tuple[str, ...]
    motions: tuple[str, ...]
    """Names of the units of inference: motions, or blocks of a motion."""
    repeat_of: tuple[str, ...]
    """Motions with the same text repeat one another; empty text: never repeated."""
    joint_of: Integers
    """Index of the joint of each residual, (n,)."""
    motion_of: Integers
    """Index of the motion of each residual, (n,)."""
    time_s: Array
    """Time of each residual in its motion, (n,)."""
    method: str
    """How the residuals are made: a sentence for a report."""
    step_s: float
    """Time step of the simulation; 0 for a kind that simulates nothing."""
    noise_std: float
    """Standard deviation of the noise of all residuals, in their unit, if it is known to be white; 0: only
    repeats show the noise."""
    by_motion: bool
    """True if `residuals` also takes sizes that differ from motion to motion, (n_candidates, n_motions, total
    sizes)."""

    def residuals(self, effects: Sequence[Effect], sizes: Array) -> Array:
        """Return the residuals of candidates, (n_candidates, n).

        Args:
            effects: Union of the effects of all candidates.
            sizes: Sizes of all effects one after the other, (n_candidates, total sizes); zeros where absent.
                Where `by_motion` is true, also (n_candidates, n_motions, total sizes).
        """
        ...

    def select(self, motions: Sequence[str]) -> "ResidualModel":
        """Return the residuals of these motions alone, which cost less."""
        ...

    def explain(self, name: str) -> Array:
        """Return a variable on which a residual may depend, (n,), at the measured motion.

        Args:
            name: "position", "velocity", "load", "time", "temperature" or "command".
        """
        ...


def residuals_by_motion(model: ResidualModel, effects: Sequence[Effect], sizes: Array) -> Array:
    """Return the residuals of candidates whose sizes differ from motion to motion.

    Args:
        effects: Union of the effects of all candidates.
        sizes: Sizes of all effects one after the other, in their own units, (n_candidates, n_motions, total
            sizes).

    Returns:
        (n_candidates, n), in the unit of the model.
    """
    if model.by_motion:
        return model.residuals(effects, sizes)
    found = []
    for candidate in sizes:
        distinct, which = np.unique(candidate, axis=0, return_inverse=True)
        rows = model.residuals(effects, distinct)
        found.append(rows[which.reshape(-1)[model.motion_of], np.arange(rows.shape[1])])
    return np.array(found)

"""What the diagnosis asks of a simulator: all that it ever sees of a robot."""

from collections.abc import Mapping
from typing import Protocol

from fsw.kinematics.transforms import Array
from ground.diagnosis.hypothesis import Hypothesis, Nuisance
from ground.diagnosis.layout import Layout

Settings = Mapping[Hypothesis, Array]
"""Values of all parameters of the effects that are there, in their order and units; absent if not named."""


class Simulator(Protocol):
    """A simulator bound to one campaign: to what its logs say was commanded, and where each motion began.

    The same arguments give the same numbers. A prediction depends on settings and nuisances only, never on
    what the logs measured in the features.
    """

    @property
    def layout(self) -> Layout:
        """The m features."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """What may be the cause, each once."""

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """What may differ without being the cause (q)."""

    def predict(self, settings: Settings, nuisance: Array) -> Array:
        """The features (m,) with these effects and these departures of the nuisances (q,), in their units.

        A nuisance that is drawn in every block departs equally in all of them here.
        """

"""What was measured in a campaign, feature by feature: known before there are data.

A feature is one number of a log in which measurement and simulator are compared. Nothing here knows which
robot it is of: places, channels and regimes are names that an adapter gives.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsw.kinematics.transforms import Array

Ints = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """What each of m features is; ValueError if the arrays do not agree or a number is not finite."""

    sigma: Array
    """Repeatability floor: one sigma of a feature between repeats, in its channel's unit, (m,)."""
    block: Ints
    """Which motion under which condition: the unit of cross-validation and of the bootstrap, (m,)."""
    channel: Ints
    """(m,)."""
    place: Ints
    """Where on the robot it was measured, (m,)."""
    regime: Ints
    """(m,)."""
    condition: Array
    """What a gap may depend on (temperature, load, speed, angle); 0 where it does not apply, (m, c)."""
    blocks: tuple[str, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    """Of the channels."""
    places: tuple[str, ...]
    regimes: tuple[str, ...]
    conditions: tuple[str, ...]

    def __post_init__(self) -> None:
        m = self.sigma.size
        if self.condition.shape != (m, len(self.conditions)):
            raise ValueError(f"condition is {self.condition.shape}; wanted {(m, len(self.conditions))}")
        if not (np.all(np.isfinite(self.condition)) and np.all(np.isfinite(self.sigma))):
            raise ValueError("sigma and condition must be finite")
        if not np.all(self.sigma > 0.0):
            raise ValueError("the floor of every feature must be above 0")
        if len(self.units) != len(self.channels):
            raise ValueError(f"{len(self.units)} units of {len(self.channels)} channels")
        for what, index, names in (
            ("block", self.block, self.blocks),
            ("channel", self.channel, self.channels),
            ("place", self.place, self.places),
            ("regime", self.regime, self.regimes),
        ):
            if index.shape != (m,):
                raise ValueError(f"{what} is {index.shape}; wanted {(m,)}")
            if m and not 0 <= index.min() <= index.max() < len(names):
                raise ValueError(f"{what} must be among its {len(names)} names")

    @property
    def size(self) -> int:
        """Number of features."""
        return self.sigma.size

    def of(self, rows: Ints) -> "Layout":
        """Some of the features, in that order; all names are kept."""
        arrays = ("sigma", "block", "channel", "place", "regime", "condition")
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays})


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a log says of a campaign's features; ValueError if it does not fit the layout."""

    layout: Layout
    value: Array
    """Measured less what the nominal simulator predicts, in the units of the channels, (m,)."""

    def __post_init__(self) -> None:
        if self.value.shape != (self.layout.size,):
            raise ValueError(f"value is {self.value.shape}; wanted {(self.layout.size,)}")
        if not np.all(np.isfinite(self.value)):
            at = int(np.flatnonzero(~np.isfinite(self.value))[0])
            channel = self.layout.channels[self.layout.channel[at]]
            raise ValueError(f"feature {at} ({channel}) is not finite")

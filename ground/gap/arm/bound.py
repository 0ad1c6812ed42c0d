"""The simulator of one case, in the features of the campaign whose sensitivities are known."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.arm.campaign import Compared, measured_values
from ground.gap.arm.features import CONDITIONS, Moving
from ground.gap.arm.simulator import ArmSimulator, Touched
from ground.gap.hypothesis import Hypothesis, Nuisance
from ground.gap.layout import Ints, Layout
from ground.gap.simulator import Settings

MOTION: Final = tuple(CONDITIONS.index(name) for name in ("speed_rad_s", "sin_angle", "cos_angle", "way"))
MOTION_APART: Final = 0.02
"""Of one motion in two logs: speeds [rad/s], sines and cosines of angles differ by less."""


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """A case's simulator (ground.gap.simulator.Simulator) in m features of a campaign."""

    arm: ArmSimulator
    nominal: Array
    """What the simulator has for all features of the case under its own drive, (n,)."""
    at: Ints
    """Which of them each of the m features is."""
    rows: Ints
    """Which of the campaign's features they are, ascending, (m,)."""

    @property
    def layout(self) -> Layout:
        """The m features."""
        return self.arm.layout.of(self.at)

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The arm's."""
        return self.arm.hypotheses

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """The arm's."""
        return self.arm.nuisances

    def predict(self, settings: Settings, nuisance: Array) -> Array:
        """The features (m,); of repeats only the first is simulated."""
        effects = tuple(self.arm.effects(settings, nuisance))
        if not effects:
            return np.asarray(self.nominal[self.at])
        known, touched = first_of_block(self.arm.campaign), Touched(effects)

        def wanted(one: Moving) -> bool:
            return one.recording.name in known and touched(one)

        change = self.arm.predicted(effects, wanted) - self.nominal
        return np.asarray((self.nominal + repeated(self.arm.campaign, known, change))[self.at])

    def gap(self) -> Array:
        """What was measured less what the simulator has, (m,)."""
        return np.asarray((measured_values(self.arm.campaign) - self.nominal)[self.at])


def bound(arm: ArmSimulator, layout: Layout, keys: Sequence[str], nominal: Array | None = None) -> Bound:
    """To those features of a campaign, by their keys, that the case has too.

    One prediction is made, unless `nominal` has what the simulator had of the campaign, (M,). A feature that
    has the key but was of another motion (at another angle or speed) is none.
    """
    number = {key: k for k, key in enumerate(keys_of(arm.campaign))}
    rows = np.array([row for row, key in enumerate(keys) if key in number], np.intp)
    at = np.array([number[keys[row]] for row in rows], np.intp)
    here = _predicted(arm) if nominal is None else np.full(arm.layout.size, np.nan)
    if nominal is not None:
        here[at] = nominal[rows]
    apart = np.abs(arm.layout.condition[at] - layout.condition[rows])[:, list(MOTION)]
    same = np.all(apart < MOTION_APART, axis=1) & np.isfinite(here[at])
    return Bound(arm, here, at[same], rows[same])


def _predicted(arm: ArmSimulator) -> Array:
    """Of the case under its own drive, (n,); NaN of repeats that have features their firsts have not."""
    known = first_of_block(arm.campaign)
    return repeated(arm.campaign, known, arm.predicted((), lambda one: one.recording.name in known), np.nan)


def keys_of(campaign: Compared) -> list[str]:
    """A name for each feature, the same in every recording of the session."""
    named = zip(campaign.sessions, campaign.features, strict=True)
    return [f"{session}/{feature.key}" for session, feature in named]


def first_of_block(campaign: Compared) -> set[str]:
    """The moving recordings that repeat none before them."""
    first: dict[str, str] = {}
    for one in campaign.moving:
        first.setdefault(one.recording.block, one.recording.name)
    return set(first.values())


def repeated(campaign: Compared, first: set[str], values: Array, otherwise: float = 0.0) -> Array:
    """What was not simulated: of repeats as in the first of their block."""
    known = {
        (feature.block, feature.key): value
        for session, feature, value in zip(campaign.sessions, campaign.features, values, strict=True)
        if session in first and np.isfinite(value)
    }
    named = zip(campaign.features, values, strict=True)
    filled = [v if np.isfinite(v) else known.get((f.block, f.key), otherwise) for f, v in named]
    return np.array(filled)

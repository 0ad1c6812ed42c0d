"""The simulator of one case, in the features of the campaign whose sensitivities are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.diagnosis.arm.campaign import Compared, all_of, measured_values
from ground.diagnosis.arm.features import CONDITIONS, Moving
from ground.diagnosis.arm.simulator import ArmSimulator, Touched
from ground.diagnosis.hypothesis import Hypothesis, Nuisance
from ground.diagnosis.layout import Ints, Layout
from ground.diagnosis.simulator import Settings
from sim.effects.effect import Effect

MOTION: Final = tuple(CONDITIONS.index(name) for name in ("speed_rad_s", "sin_angle", "cos_angle", "way"))
MOTION_APART: Final = 0.02
"""Of one motion in two logs: speeds [rad/s], sines and cosines of angles differ by less."""


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """A case's simulator (ground.diagnosis.simulator.Simulator) in m features of a campaign."""

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
        return np.asarray((self.nominal + changed(self.arm, effects, self.nominal))[self.at])

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
    same = np.all(apart < MOTION_APART, axis=1) & _told(arm.campaign)[at]
    return Bound(arm, here, at[same], rows[same])


def asked_again(
    case: Bound, patch: tuple[Effect, ...], only: Callable[[Moving], bool], otherwise: Array
) -> Bound:
    """The same with another patch: rests, and the moving recordings that are wanted, are computed anew.

    The others change by `otherwise` (m,).
    """
    arm, known = case.arm.patched(patch), first_of_block(case.arm.campaign)
    there = arm.predicted((), lambda one: one.recording.name in known and only(one))
    anew, near = repeated(arm.campaign, known, there, np.nan), case.nominal.copy()
    near[case.at] += otherwise
    return replace(case, arm=arm, nominal=np.where(np.isfinite(anew), anew, near))


def changed(
    arm: ArmSimulator, effects: tuple[Effect, ...], nominal: Array, only: Callable[[Moving], bool] = all_of
) -> Array:
    """By how much effects change all features of a case, (n,); 0 of motions that are not stepped.

    Of a block's repeats only the first is stepped, and only where the effects can show.
    """
    touched, known = Touched(effects), first_of_block(arm.campaign)

    def wanted(one: Moving) -> bool:
        return one.recording.name in known and touched(one) and only(one)

    return repeated(arm.campaign, known, arm.predicted(effects, wanted) - nominal)


def _told(campaign: Compared) -> Flags:
    """Features that any simulation tells, (n,): of repeats those alone that their firsts have too."""
    known = first_of_block(campaign)
    stepped = [np.full(len(one.features), one.recording.name in known) for one in campaign.moving]
    rests = np.ones(sum(len(one.features) for one in campaign.posed), bool)
    simulated = np.where(np.concatenate([*stepped, rests]), 1.0, np.nan)
    return np.isfinite(repeated(campaign, known, simulated, np.nan))


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

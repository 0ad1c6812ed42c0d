"""A campaign's features with the plant stepped everywhere, at rest too: right for effects of any kind.

Statics know what flight parameters have a word for and what acts on gears and outputs; an effect that
nobody has seen before may move a link otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fsw.kinematics.transforms import Array, Pose, inverse
from ground.calibration.screws import screw_log
from ground.gap.arm.campaign import STEPPED, Compared, Posed
from ground.gap.arm.features import Columns, Moving, measured
from ground.gap.arm.logs import Recording
from ground.gap.arm.poses import in_order, read_resolvers
from sim.driven import DrivenArm, Manner
from sim.effects.effect import Effect
from sim.tracker import turret_pose


@dataclass(frozen=True, slots=True, eq=False)
class Stepped:
    """What a stepped plant shows of one recording."""

    sensors: Columns
    X_RF: dict[int, Pose]
    """The turret at the end of some ticks."""


@lru_cache(maxsize=64)
def stepped(
    recording: Recording, effects: tuple[Effect, ...], manner: Manner, ticks: frozenset[int]
) -> Stepped:
    """Under the recorded drive; PlantDiverged if MuJoCo counted a warning. Asked again it is the same."""
    arm = DrivenArm(recording.start, in_order(recording, effects), manner)
    readings, poses = [], {}
    for tick, drive in enumerate(recording.drives):
        readings.append(arm.avionics.sense())
        arm.avionics.apply(drive)
        arm.plant.step()
        if tick in ticks:
            arm.plant.truth()  # brings the kinematics up to date
            poses[tick] = turret_pose(arm.plant)
    return Stepped({name: np.array([getattr(one, name) for one in readings]) for name in STEPPED}, poses)


def change(campaign: Compared, effects: Sequence[Effect], manner: Manner) -> Array:
    """By how much effects change the features, (m,)."""
    return np.concatenate(
        [_moving(one, effects, manner) for one in campaign.moving]
        + [_posed(one, effects, manner) for one in campaign.posed]
    )


def _moving(one: Moving, effects: Sequence[Effect], manner: Manner) -> Array:
    with_it, without = (stepped(one.recording, some, manner, frozenset()) for some in (tuple(effects), ()))
    return measured(one, with_it.sensors) - measured(one, without.sensors)


def _posed(one: Posed, effects: Sequence[Effect], manner: Manner) -> Array:
    recording = one.knots.recording
    ticks = [one.knots.tick[one.knots.rests[r]] for r, _ in one.seen]
    with_it, without = (stepped(recording, some, manner, frozenset(ticks)) for some in (tuple(effects), ()))
    resolvers = _resolvers(one, with_it) - _resolvers(one, without)
    if not ticks:
        return np.asarray(resolvers.ravel())
    before, after = (_stacked([found.X_RF[tick] for tick in ticks]) for found in (without, with_it))
    return np.concatenate([resolvers.ravel(), screw_log(inverse(before) @ after).ravel()])


def _stacked(poses: list[Pose]) -> Pose:
    return Pose(np.stack([pose.R for pose in poses], -1), np.stack([pose.p for pose in poses], -1))


def _resolvers(one: Posed, found: Stepped) -> Array:
    """Less encoders, at the rests, (5, r)."""
    recording = replace(one.knots.recording, sensors=found.sensors)
    return read_resolvers(replace(one.knots, recording=recording))

"""A campaign's features with the plant stepped everywhere, at rest too: right for effects of any kind.

Statics know what flight parameters have a word for and what acts on gears and outputs; an effect that
nobody has seen before may move a link otherwise.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fsw.kinematics.transforms import Array, inverse, stack_poses
from ground.calibration.screws import screw_log
from ground.diagnosis.arm.campaign import Compared, Posed
from ground.diagnosis.arm.features import Moving, measured
from ground.diagnosis.arm.logs import Recording
from ground.diagnosis.arm.poses import read_resolvers
from ground.diagnosis.arm.stepped import Stepped, columns, stepped, stepped_once
from sim.effects.effect import Effect
from sim.open_loop import SimulationOptions


def change(campaign: Compared, effects: Sequence[Effect], manner: SimulationOptions) -> Array:
    """By how much effects change the features, (m,)."""
    return np.concatenate(
        [_moving(one, effects, manner) for one in campaign.moving]
        + [_posed(one, effects, manner) for one in campaign.posed]
    )


def _moving(one: Moving, effects: Sequence[Effect], manner: SimulationOptions) -> Array:
    with_it, without = _both(one.recording, effects, manner)
    return measured(one, columns(with_it.readings)) - measured(one, columns(without.readings))


def _posed(one: Posed, effects: Sequence[Effect], manner: SimulationOptions) -> Array:
    recording = one.knots.recording
    ends = [one.knots.tick[one.knots.rests[r]] + 1 for r, _ in one.seen]
    with_it, without = _both(recording, effects, manner, frozenset(ends))
    resolvers = _resolvers(one, with_it) - _resolvers(one, without)
    if not ends:
        return np.asarray(resolvers.ravel())
    before, after = (stack_poses([found.X_RF[end] for end in ends]) for found in (without, with_it))
    return np.concatenate([resolvers.ravel(), screw_log(inverse(before) @ after).ravel()])


def _both(
    recording: Recording,
    effects: Sequence[Effect],
    manner: SimulationOptions,
    looked: frozenset[int] = frozenset(),
) -> tuple[Stepped, Stepped]:
    """With effects, and without: that is asked again for every effect."""
    return stepped(recording, effects, manner, looked), stepped_once(recording, (), manner, looked)


def _resolvers(one: Posed, found: Stepped) -> Array:
    """Less encoders, at the rests, (5, r)."""
    recording = replace(one.knots.recording, sensors=columns(found.readings))
    return read_resolvers(replace(one.knots, recording=recording))

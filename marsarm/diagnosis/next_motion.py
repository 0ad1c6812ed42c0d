"""Choose the motion that tells the rivals of a finding apart best, by sensitivities of planned motions."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.normal_equations import build_whitener
from marsarm.diagnosis.problem import Hypothesis, Ints
from marsarm.diagnosis.selection import FeatureEffect
from marsarm.diagnosis.sensitivity import Sensitivities
from simgap.next_motion.proposal import Curve, Proposal
from simgap.next_motion.rivals import choose_rivals
from simgap.next_motion.separation import Slopes, choose_motion, scale_slopes
from simgap.result import Rival

MOST_DRAWN: Final = 4
"""Channels that are drawn: those in which the rivals differ most."""
BIN_s: Final = 0.25
"""Time between two features of a channel in motion."""


def propose_motion(
    model: DiagnosisModel, rivals: Sequence[Rival], planned: Sensitivities, words: Mapping[str, str]
) -> Proposal:
    """Propose the motion that tells the rivals of the finding in most doubt apart.

    Calibration errors and sizes of effects are fitted again, with what the earlier motions say of them. The
    sensitivities of planned motions have the effects of these rivals; each is a block with its words.
    RobotError if no finding has a rival.
    """
    group = choose_rivals(rivals)
    settings = [_settings(one) for one in group]
    changes = np.array([planned.change({h: h.values(a) for h, a in own.items()}) for own in settings])
    white = build_whitener(planned)(changes.T).T
    new = [_slopes(planned, own) for own in settings]
    old = [_slopes(model.sensitivities, own) for own in settings]
    known = np.ones(len(planned.shared_nuisances))
    priors = [np.concatenate([known, np.full(_sizes(own).size, np.inf)]) for own in settings]
    blocks = np.unique(planned.layout.block)
    rows = [np.flatnonzero(planned.layout.block == block) for block in blocks]

    def differentiate(some: Sequence[int]) -> list[Slopes]:
        return [[scale_slopes(new[k][rows[m]], old[k], priors[k]) for k in range(len(group))] for m in some]

    choice = choose_motion([white[:, own] for own in rows], differentiate)
    named = tuple(words[planned.layout.blocks[block]] for block in blocks)
    curves = tuple(_draw(planned, changes, rows[choice.motions[0]])) if choice.motions else ()
    return Proposal(group[0].finding, tuple(one.effect for one in group), named, choice, curves)


def _settings(rival: Rival) -> dict[Hypothesis, Array]:
    """Return the departures of the effects of a rival in typical sizes."""
    pairs = zip(rival.effects, rival.sizes, strict=True)
    return {one.hypothesis: np.array(size) for one, size in pairs if isinstance(one, FeatureEffect)}


def _sizes(settings: Mapping[Hypothesis, Array]) -> Array:
    return np.concatenate([*settings.values()])


def _slopes(sensitivities: Sensitivities, settings: Mapping[Hypothesis, Array]) -> Array:
    """Return whitened changes by shared nuisances, in their sigmas, and by effects, in typical sizes."""
    shared = sensitivities.shared_nuisances
    sigma = np.array([sensitivities.nuisances[k].sigma for k in shared])
    owners = [sensitivities.index(one.key) for one in settings]
    columns: Ints = np.concatenate([np.flatnonzero(sensitivities.owner == k) for k in owners])
    reach = sensitivities.reach[columns]
    at = np.clip(_sizes(settings), -reach, reach)  # beyond it, the parabola goes on as a line
    slope = sensitivities.effect[:, columns] + 2.0 * at * sensitivities.curve[:, columns]
    every = np.hstack([sensitivities.nuisance[:, shared] * sigma, slope])
    return np.asarray(build_whitener(sensitivities)(every))


def _draw(planned: Sensitivities, changes: Array, rows: Ints) -> list[Curve]:
    """Draw what rivals predict in the channels in which they differ most, in noise floors."""
    layout, curves = planned.layout, []
    for channel in np.unique(layout.channel[rows]):
        own = rows[layout.channel[rows] == channel]
        predicted, noise = changes[:, own], float(np.mean(layout.sigma[own]))
        time_s = BIN_s * np.arange(float(own.size))
        differing = predicted - predicted.mean(axis=0)
        curves.append(Curve(layout.channels[channel], layout.units[channel], time_s, differing, noise))
    return sorted(curves, key=lambda one: -float(np.max(np.abs(one.values))) / one.noise)[:MOST_DRAWN]

"""The repeatability floor of a campaign's features: from repeats, or what it is assumed to be."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.diagnosis.arm.campaign import Compared, measured_values
from ground.diagnosis.arm.features import CHANNELS, assumed_sigma

FEWEST = 8
"""Pairs of a channel that tell its floor."""

DOUBTED = 3.0
"""Sigmas from which on doubt about a feature is counted."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """One sigma of every feature between repeats, (m,), and where it comes from."""

    sigma: Array
    notes: tuple[str, ...]


def floor_of(campaign: Compared) -> Floor:
    """Channel by channel what repeats differ by, over what was assumed; never below that."""
    features, values = campaign.features, measured_values(campaign)
    sigma = np.array([assumed_sigma(feature) for feature in features])
    sigma = np.where(np.isfinite(tracker := _tracker_sigma(campaign)), tracker, sigma)
    known: dict[tuple[str, str], int] = {}
    pairs: list[tuple[int, int]] = []
    for k, feature in enumerate(features):
        first = known.setdefault((feature.block, feature.key), k)
        if first != k:
            pairs.append((first, k))
    doubt = np.array([feature.doubt for feature in features])
    doubted = doubt > DOUBTED * sigma
    notes = []
    channel = np.array([feature.channel for feature in features])
    for number, name in enumerate(CHANNELS):
        mine = [(a, b) for a, b in pairs if features[a].channel == number and not doubted[a]]
        if not (channel == number).any():
            continue
        if len(mine) < FEWEST:
            notes.append(f"{name}: {len(mine)} repeats, so its floor is assumed to be the sensors' noise")
            continue
        a, b = np.array(mine).T
        ratio = float(np.sqrt(np.mean(((values[a] - values[b]) / sigma[a]) ** 2) / 2.0))
        sigma[channel == number] *= max(ratio, 1.0)
        notes.append(f"{name}: {len(mine)} pairs of repeats differ by {ratio:.2f} times the sensors' noise")
    if doubted.any():
        notes.append(
            f"{int(doubted.sum())} of {doubted.size} features hardly count: the arm rests where friction "
            f"nearly lets go, a joint has not yet turned through its gap, or a tool is about to touch"
        )
    return Floor(np.where(doubted, np.hypot(sigma, doubt), sigma), tuple(notes))


def _tracker_sigma(campaign: Compared) -> Array:
    """What the tracker's own fits say of its poses; NaN elsewhere."""
    found = [np.full(len(one.features), np.nan) for one in campaign.moving]
    for posed in campaign.posed:
        seen = [k for _, k in posed.seen]
        screws = posed.knots.recording.tracked.sigma[:, seen].ravel()
        others = np.full(len(posed.features) - screws.size, np.nan)
        found.append(np.concatenate([others, screws]))
    return np.concatenate(found)

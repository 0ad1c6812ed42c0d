"""Noise floor of a campaign's features: estimated from repeats, else assumed from sensor noise."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from marsarm.diagnosis.arm.feature_set import FeatureSet, measure_features
from marsarm.diagnosis.arm.features import CHANNELS, assumed_sigma

MIN_PAIRS = 8
"""Least number of pairs of repeats that estimate the noise floor of a channel."""

DOUBT_SIGMAS = 3.0
"""Doubt above this many sigmas of the noise is added to the noise floor."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFloor:
    """Standard deviation of every feature between repeats, shape (m,), and notes on its origin."""

    sigma: Array
    notes: tuple[str, ...]


def estimate_floor(feature_set: FeatureSet) -> NoiseFloor:
    """Estimate the noise floor by channel from repeats; it is never below the assumed sensor noise."""
    features, values = feature_set.list_features(), measure_features(feature_set)
    sigma = np.array([assumed_sigma(feature) for feature in features])
    sigma = np.where(np.isfinite(tracker := _tracker_sigma(feature_set)), tracker, sigma)
    known: dict[tuple[str, str], int] = {}
    pairs: list[tuple[int, int]] = []
    for k, feature in enumerate(features):
        first = known.setdefault((feature.block, feature.key), k)
        if first != k:
            pairs.append((first, k))
    doubt = np.array([feature.doubt for feature in features])
    doubted = doubt > DOUBT_SIGMAS * sigma
    notes = []
    channel = np.array([feature.channel for feature in features])
    for number, name in enumerate(CHANNELS):
        mine = [(a, b) for a, b in pairs if features[a].channel == number and not doubted[a]]
        if not (channel == number).any():
            continue
        if len(mine) < MIN_PAIRS:
            notes.append(f"{name}: {len(mine)} repeats, so its floor is assumed to be the sensors' noise")
            continue
        a, b = np.array(mine).T
        ratio = float(np.sqrt(np.mean(((values[a] - values[b]) / sigma[a]) ** 2) / 2.0))
        sigma[channel == number] *= max(ratio, 1.0)
        notes.append(f"{name}: {len(mine)} pairs of repeats differ by {ratio:.2f} times the sensors' noise")
    if doubted.any():
        notes.append(
            f"{int(doubted.sum())} of {doubted.size} features have little weight: the arm rests near the "
            f"friction limit, a joint has not yet turned through its backlash, or a tool is about to touch"
        )
    return NoiseFloor(np.where(doubted, np.hypot(sigma, doubt), sigma), tuple(notes))


def _tracker_sigma(feature_set: FeatureSet) -> Array:
    """Return the standard deviations of tracker poses by the tracker; NaN elsewhere."""
    found = [np.full(len(one.features), np.nan) for one in feature_set.motions]
    for posed in feature_set.rests:
        seen = [k for _, k in posed.tracked_rests]
        screws = posed.turning_points.recording.tracker_poses.sigma[:, seen].ravel()
        others = np.full(len(posed.features) - screws.size, np.nan)
        found.append(np.concatenate([others, screws]))
    return np.concatenate(found)

"""Rates with exact intervals."""

from dataclasses import dataclass

from scipy.stats import beta


@dataclass(frozen=True, slots=True)
class Rate:
    """How often, with its exact interval; 0 to 1 if there was no case."""

    hits: int
    of: int
    least: float
    most: float

    @property
    def share(self) -> float:
        """NaN if there was no case."""
        return self.hits / self.of if self.of else float("nan")


def estimate_rate(hits: int, of: int, level: float = 0.95) -> Rate:
    """ValueError unless 0 <= hits <= of."""
    return Rate(hits, of, *clopper_pearson(hits, of, level))


def clopper_pearson(hits: float, of: int, level: float = 0.95) -> tuple[float, float]:
    """Least and most that the probability of a hit may be; hits need not be whole.

    At these so many hits or more, or so few or fewer, have (1 - level) / 2: quantiles of beta distributions
    (Clopper and Pearson 1934).

    Raises:
        ValueError: not 0 <= hits <= of.
    """
    if not 0 <= hits <= of:
        raise ValueError(f"{hits} hits of {of}")
    tail = (1.0 - level) / 2.0
    least = float(beta.ppf(tail, hits, of - hits + 1)) if hits else 0.0
    most = float(beta.isf(tail, hits + 1, of - hits)) if hits < of else 1.0
    return least, most

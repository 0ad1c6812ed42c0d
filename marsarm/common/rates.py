"""Proportions of hits with exact confidence intervals."""

from dataclasses import dataclass

from scipy.stats import beta


@dataclass(frozen=True, slots=True)
class Rate:
    """Proportion of hits with its exact confidence interval, which is 0 to 1 if there was no case."""

    hits: int
    of: int
    """Number of cases."""
    least: float
    """Lower end of the interval."""
    most: float
    """Upper end of the interval."""

    @property
    def share(self) -> float:
        """Observed proportion; NaN if there was no case."""
        return self.hits / self.of if self.of else float("nan")


def estimate_rate(hits: int, of: int, level: float = 0.95) -> Rate:
    """Estimate a proportion with its Clopper-Pearson interval.

    Raises:
        ValueError: not 0 <= hits <= of.
    """
    return Rate(hits, of, *clopper_pearson(hits, of, level))


def clopper_pearson(hits: float, of: int, level: float = 0.95) -> tuple[float, float]:
    """Compute the exact confidence interval of the probability of a hit (Clopper and Pearson 1934).

    At the lower end, as many hits or more have the probability (1 - level) / 2. At the upper end, as many or
    fewer have it. Both ends are quantiles of beta distributions.

    Args:
        hits: Number of hits, not necessarily whole.
        of: Number of cases.
        level: Confidence level.

    Returns:
        Lower and upper end of the interval.

    Raises:
        ValueError: not 0 <= hits <= of.
    """
    if not 0 <= hits <= of:
        raise ValueError(f"{hits} hits of {of}")
    tail = (1.0 - level) / 2.0
    least = float(beta.ppf(tail, hits, of - hits + 1)) if hits else 0.0
    most = float(beta.isf(tail, hits + 1, of - hits)) if hits < of else 1.0
    return least, most

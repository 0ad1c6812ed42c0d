"""Bars of a score: how often verdicts on sealed cases are right, level by level, by exact tests at 5 %."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from marsarm.common.rates import RateBar, check_rate
from validation.cases.sealed import CaseScore

LEVELS: Final = ("place", "family", "effect")


@dataclass(frozen=True, slots=True)
class JudgedEffect:
    """Verdict on a true effect of the catalogue, from its detection limit on."""

    is_reported: bool
    has_place: bool = False
    has_effect: bool = False
    """True if the right one comes first."""
    is_covered: bool | None = None
    """True if the set of the lowest reported level holds the truth; None without a set."""


def level_bars(
    alarms: Iterable[bool],
    outside: Sequence[tuple[bool, bool, bool]],
    effects: Sequence[JudgedEffect],
    wrong_rates: tuple[float, float, float],
) -> dict[str, RateBar]:
    """Return the bars of cases without effect, outside the catalogue (wrong by level), and of effects."""
    reported = [one for one in effects if one.is_reported]
    sets = [one.is_covered for one in reported if one.is_covered is not None]
    return {
        "false alarms": check_rate(alarms, 0.05, True),
        **{
            f"outside, wrong {level}": check_rate((one[k] for one in outside), wrong_rates[k], True)
            for k, level in enumerate(LEVELS)
        },
        "reported": check_rate((one.is_reported for one in effects), 0.85, False),
        "right place": check_rate((one.has_place for one in reported), 0.95, False),
        "right effect": check_rate((one.has_effect for one in reported), 0.88, False),
        "set coverage": check_rate(sets, 0.95, False),
    }


def score_bars(
    bars: Mapping[str, RateBar], count: int, more: Mapping[str, Any], in_bounds: bool = True
) -> CaseScore:
    """Return a score of `count` solved cases by bars, which have to be met, as all other bounds have to."""
    verdicts = {name: {**asdict(bar), "met": bar.is_met} for name, bar in bars.items()}
    document = {"cases": count, "bars": verdicts, **more}
    rows = [
        (name, f"at {'most' if bar.is_most else 'least'} {bar.rate:g}", f"{bar.hits} of {bar.of}",
         "met" if bar.is_met else "missed")
        for name, bar in bars.items()
    ]  # fmt: skip
    return CaseScore(document, tuple(rows), in_bounds and all(bar.is_met for bar in bars.values()))

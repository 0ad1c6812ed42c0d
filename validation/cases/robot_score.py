"""Score of cases of any robot: results against the sealed truth, with one-sided exact tests at 5 %."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import permutations
from statistics import mean, median
from typing import Any, Final

from marsarm.common.rates import RateBar, check_rate
from validation.cases.robot_draw import DrawnEffect, Truth
from validation.cases.sealed import CaseScore, Table

SET_SIZE_BAR: Final = 2.0
SECONDS_BAR: Final = 60.0
BASE_NAMES: Final = frozenset({"base", "world"})

Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SealedCase:
    """Case with its truth, and the hypotheses that no data separate from each of its effects."""

    name: str
    truth: Truth
    equivalents: tuple[tuple[tuple[str, str], ...], ...]
    """For each effect: names with places."""


@dataclass(frozen=True, slots=True)
class Pairing:
    """True effect of the catalogue with the finding that is best for it."""

    effect: DrawnEffect
    accepted: frozenset[tuple[str, str]]
    """Names and places of its equivalence class."""
    finding: Document | None


def plain_name(text: str) -> str:
    """Return the name of an effect without its place and without the order or neighbour after it."""
    name = text.rpartition(": ")[2]
    return name.split(" of order ")[0].split(" of many orders")[0].split(" to ")[0]


def plain_place(text: str) -> str:
    """Return the place; the base has two names."""
    return "base" if text in BASE_NAMES else text


def named(key: str, place: str) -> tuple[str, str]:
    """Return the name and the place of a key "place: name"; the place of the finding where it has none."""
    before = key.rpartition(": ")[0]
    return plain_name(key), plain_place(before or place)


def members(finding: Document) -> set[tuple[str, str]]:
    """Return the names and places of the reported set."""
    return {named(key, finding["place"]) for key in finding["effects"]}


def first_choice(finding: Document) -> tuple[str, str]:
    """Return the name and the place that a finding puts first."""
    return named(finding["effect"], finding["place"])


def places(finding: Document) -> set[str]:
    """Return the places of the reported set."""
    return {plain_place(one) for one in (finding["place"], *finding["places"])}


def pair_up(case: SealedCase, findings: list[Document]) -> tuple[list[Pairing], list[Document]]:
    """Give each true effect the finding that fits it best, and return the findings that are left."""
    classes = [frozenset((name, plain_place(place)) for name, place in one) for one in case.equivalents]
    slots: list[Document | None] = [*findings, *[None] * len(classes)]

    def fit(accepted: frozenset[tuple[str, str]], finding: Document | None) -> int:
        if finding is None:
            return 0
        is_place = plain_place(finding["place"]) in {place for _, place in accepted}
        return 1 + 4 * (first_choice(finding) in accepted) + 2 * is_place

    best = max(
        permutations(range(len(slots)), len(classes)),
        key=lambda order: sum(fit(one, slots[k]) for one, k in zip(classes, order, strict=True)),
    )
    pairs = [
        Pairing(effect, accepted, slots[k])
        for effect, accepted, k in zip(case.truth.effects, classes, best, strict=True)
    ]
    return pairs, [finding for k, finding in enumerate(findings) if k not in best]


def is_covered(pair: Pairing) -> bool:
    """Return whether the reported set holds the truth, at the lowest level that was reported."""
    finding = pair.finding
    assert finding is not None
    if finding["effects"]:
        return bool(members(finding) & pair.accepted)
    if finding["families"]:
        return pair.effect.family in finding["families"]
    return bool(places(finding) & {place for _, place in pair.accepted})


def has_wrong_place(case: SealedCase, findings: list[Document]) -> bool:
    """Return whether a finding gives places without the true one."""
    accepted = {plain_place(case.truth.effects[0].place), *(plain_place(p) for _, p in case.equivalents[0])}
    return any(not places(finding) & accepted for finding in findings)


def has_wrong_family(case: SealedCase, findings: list[Document]) -> bool:
    """Return whether a finding gives families, none of which is right."""
    accepted = set(case.truth.effects[0].families)
    return any(finding["families"] and not accepted & set(finding["families"]) for finding in findings)


def has_wrong_effect(case: SealedCase, findings: list[Document]) -> bool:
    """Return whether a finding names an effect that the data can tell from the true one."""
    accepted = {(name, plain_place(place)) for name, place in case.equivalents[0]}
    return any(members(finding) - accepted for finding in findings)


def score_cases(solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
    """Score solved cases."""
    by_kind = {kind: [one for one in solved if one[0].truth.kind == kind] for kind in ("none", "outside")}
    outside = [(case, list(result["findings"])) for case, result in by_kind["outside"]]
    inside = [one for one in solved if one[0].truth.kind in ("single", "pair")]
    paired = [pair_up(case, list(result["findings"])) for case, result in inside]
    clear = [pair for pairs, _ in paired for pair in pairs if pair.effect.times_limit >= 1.0]
    given = [pair for pair in clear if pair.finding is not None]
    reports = [(pair, pair.finding) for pair in given if pair.finding is not None]
    sets = [max(len(one["effects"]), 1) for _, one in reports]
    bars = {
        "false alarms": check_rate((bool(one["findings"]) for _, one in by_kind["none"]), 0.05, True),
        "outside, wrong place": check_rate((has_wrong_place(*one) for one in outside), 0.05, True),
        "outside, wrong family": check_rate((has_wrong_family(*one) for one in outside), 0.10, True),
        "outside, wrong effect": check_rate((has_wrong_effect(*one) for one in outside), 0.15, True),
        "reported": check_rate((pair.finding is not None for pair in clear), 0.85, False),
        "right place": check_rate(
            (plain_place(one["place"]) in {place for _, place in pair.accepted} for pair, one in reports),
            0.95,
            False,
        ),
        "right effect": check_rate(
            (first_choice(one) in pair.accepted for pair, one in reports), 0.88, False
        ),
        "set coverage": check_rate((is_covered(pair) for pair in given), 0.95, False),
    }
    set_size = mean(sets) if sets else None
    seconds = median(one["seconds"] for _, one in solved)
    met = all(bar.is_met for bar in bars.values())
    in_bounds = met and (set_size is None or set_size < SET_SIZE_BAR) and seconds <= SECONDS_BAR
    document = {
        "cases": len(solved),
        "bars": {name: {**asdict(bar), "met": bar.is_met} for name, bar in bars.items()},
        "mean set size": set_size,
        "further findings in cases with effects": sum(len(rest) for _, rest in paired),
        "refused": sum(bool(one.get("refused")) and not one["findings"] for _, one in solved),
        "cpu seconds, median": seconds,
    }
    return CaseScore(document, (make_table(bars),), in_bounds)


def make_table(bars: dict[str, RateBar]) -> Table:
    """Return the bars as a table."""
    rows = [
        (name, f"at {'most' if bar.is_most else 'least'} {bar.rate:g}", f"{bar.hits} of {bar.of}",
         "met" if bar.is_met else "missed")
        for name, bar in bars.items()
    ]  # fmt: skip
    return Table("Cases of any robot", ("", "wanted", "found", ""), tuple(rows))

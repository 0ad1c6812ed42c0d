"""Score of the cases: results against the sealed truth, with one-sided exact tests at 5 %."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from statistics import mean, median
from typing import Any, Final

from scipy.stats import binom

from simgap.common.errors import BadRequest
from validation.robot_cases.draw import DrawnEffect
from validation.robot_cases.seal import SealedCase, load_truth
from validation.robot_cases.solve import solved_path

TEST_LEVEL: Final = 0.05
SET_SIZE_BAR: Final = 2.0
SECONDS_BAR: Final = 60.0
BASE_NAMES: Final = frozenset({"base", "world"})

Document = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Bar:
    """Rate with its bar: at most, or at least, `rate`; missed if an exact test at 5 % rejects it."""

    hits: int
    of: int
    rate: float
    is_most: bool
    p: float
    """Probability of a count as bad or worse at exactly this rate."""

    @property
    def is_met(self) -> bool:
        """Return False if the test rejects the rate."""
        return self.p >= TEST_LEVEL


def check_rate(outcomes: Iterable[bool], rate: float, is_most: bool) -> Bar:
    """Test a rate by the binomial distribution."""
    found = list(outcomes)
    hits, of = sum(found), len(found)
    p = binom.sf(hits - 1, of, rate) if is_most else binom.cdf(hits, of, rate)
    return Bar(hits, of, rate, is_most, float(p) if of else 1.0)


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


def score_cases(solved: list[tuple[SealedCase, Document]]) -> dict[str, Any]:
    """Score solved cases; return the document."""
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
    return {
        "cases": len(solved),
        "bars": {name: _bar_document(bar) for name, bar in bars.items()},
        "mean set size": set_size,
        "further findings in cases with effects": sum(len(rest) for _, rest in paired),
        "refused": sum(bool(one.get("refused")) and not one["findings"] for _, one in solved),
        "cpu seconds, median": seconds,
        "in_bounds": met and (set_size is None or set_size < SET_SIZE_BAR) and seconds <= SECONDS_BAR,
    }


def _bar_document(bar: Bar) -> dict[str, Any]:
    limit = "at most" if bar.is_most else "at least"
    return {"hits": bar.hits, "of": bar.of, "wanted": f"{limit} {bar.rate:g}", "p": bar.p, "met": bar.is_met}


def score_folder(folder: Path, partial: bool) -> dict[str, Any]:
    """Score the cases of a folder; the truth must match its digest.

    Raises:
        BadRequest: The truth was changed, or a case is not solved.
    """
    truth, solved = load_truth(folder), []
    for case in truth.cases:
        path = solved_path(folder, case.name)
        if path.exists():
            solved.append((case, _read(path)))
        elif not partial:
            raise BadRequest(
                f"{folder}: {case.name} is not solved; solve goes on, --partial scores the others"
            )
    if not solved:
        raise BadRequest(f"{folder}: no case is solved")
    return {"digest": truth.digest(), **score_cases(solved)}


def _read(path: Path) -> Document:
    try:
        found: Document = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise BadRequest(f"{path}: is no solved case ({error}); remove it and solve again") from error
    return found

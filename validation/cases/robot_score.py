"""Score of cases of any robot: results against the sealed truth, with one-sided exact tests at 5 %.

Equivalence classes: hypotheses that no data of a case can separate from its effect.

Two hypotheses are equivalent if their changes of the fitted motions, whitened and without what nuisances
imitate, have a cosine above 0.99. Then a fit of the wrong one leaves at most 2 % of the energy of the effect:
at four detection limits of 8, that is (4 * 8)^2 * 0.02 = 20, less than the noncentrality of 64 that a
hypothesis needs. Hypotheses at the place of the effect and at the base and the tool are compared. Those at
other joints move other joints.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from statistics import mean, median
from typing import Any, Final

import numpy as np

from simgap.arrays import Array
from validation.cases import robot_inside as inside
from validation.cases.robot_draw import CaseMotions, DrawnEffect, Truth, change_of, make_effect
from validation.cases.robot_setup import information, make_nuisance
from validation.cases.robot_table import BASE, SUPPLY, Entry, PlacedEntry, list_hypotheses
from validation.cases.robot_truth import TrueEffect
from validation.cases.sealed import CaseScore, JudgedEffect, level_bars, score_bars

WRONG_RATES: Final = (0.05, 0.10, 0.15)
"""Bars of wrong places, families and effects outside the catalogue."""
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


def plain_place(text: str) -> str:
    """Return the place; the base has two names."""
    return "base" if text in BASE_NAMES else text


def named(key: str, place: str) -> tuple[str, str]:
    """Return the name and the place of a key "place: name"; the place of the finding where it has none."""
    before, _, name = key.rpartition(": ")
    name = name.split(" of order ")[0].split(" of many orders")[0].split(" to ")[0]
    return name, plain_place(before or place)


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
    trios = zip(case.truth.effects, classes, best, strict=True)
    pairs = [Pairing(effect, accepted, slots[k]) for effect, accepted, k in trios]
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


def find_wrong(case: SealedCase, findings: list[Document]) -> tuple[bool, bool, bool]:
    """Return whether a finding gives places, families, or a name without the right one among them.

    A name is wrong if the data can tell its effect from the true one.
    """
    (true, *_), (same, *_) = case.truth.effects, case.equivalents
    accepted = {(name, plain_place(place)) for name, place in same}
    right_places = {plain_place(true.place), *(place for _, place in accepted)}
    return (
        any(not places(one) & right_places for one in findings),
        any(one["families"] and not {*true.families} & {*one["families"]} for one in findings),
        any(members(one) - accepted for one in findings),
    )


def score_cases(solved: Sequence[tuple[SealedCase, Document]]) -> CaseScore:
    """Score solved cases."""
    alarms = [bool(result["findings"]) for case, result in solved if case.truth.kind == "none"]
    outside = [one for one in solved if one[0].truth.kind == "outside"]
    wrong = [find_wrong(case, list(result["findings"])) for case, result in outside]
    inside = [one for one in solved if one[0].truth.kind in ("single", "pair")]
    paired = [pair_up(case, list(result["findings"])) for case, result in inside]
    clear = [pair for pairs, _ in paired for pair in pairs if pair.effect.times_limit >= 1.0]
    sets = [max(len(pair.finding["effects"]), 1) for pair in clear if pair.finding is not None]
    bars = level_bars(alarms, wrong, [judge(pair) for pair in clear], WRONG_RATES)
    set_size = mean(sets) if sets else None
    seconds = median(one["seconds"] for _, one in solved)
    in_bounds = (set_size is None or set_size < SET_SIZE_BAR) and seconds <= SECONDS_BAR
    more = {
        "mean set size": set_size,
        "further findings in cases with effects": sum(len(rest) for _, rest in paired),
        "refused": sum(bool(one.get("refused")) and not one["findings"] for _, one in solved),
        "cpu seconds, median": seconds,
    }
    return score_bars(bars, len(solved), more, in_bounds)


def judge(pair: Pairing) -> JudgedEffect:
    """Return what the finding of a true effect says of it."""
    if pair.finding is None:
        return JudgedEffect(False)
    has_place = plain_place(pair.finding["place"]) in {place for _, place in pair.accepted}
    return JudgedEffect(True, has_place, first_choice(pair.finding) in pair.accepted, is_covered(pair))


LEAST_COSINE: Final = 0.99
SHAPED: Final = (
    *(inside.Integral, inside.Stribeck, inside.Spring),
    *(inside.PositionTorque, inside.PeriodicError, inside.GravityDirection),
)
"""Effects with a shape; two shapes of each are tried beside that of the truth."""
FAR: Final = 0.9
"""Cosine of a change at about the right size below which no size makes it equal."""


def find_equivalents(
    campaign: CaseMotions, drawn: DrawnEffect, entries: tuple[Entry, ...]
) -> tuple[tuple[str, str], ...]:
    """Return the entries, with places, that cannot be told from a true effect, itself included."""
    true = change_of(campaign, make_effect(drawn, campaign.plan.scene))
    near = {drawn.place, BASE, SUPPLY, campaign.robot.tool_site}
    own = drawn.name, drawn.place
    known = [(one, (one.entry.kind.name, one.place)) for one in list_hypotheses(campaign.robot, entries)]
    here = [(one, name) for one, name in known if one.place in near]
    return tuple(name for one, name in here if name == own or _imitates(campaign, one, drawn, true))


def _imitates(campaign: CaseMotions, one: PlacedEntry, drawn: DrawnEffect, true: Array) -> bool:
    shapes = (drawn.shape, 0.25, 0.75) if issubclass(one.entry.kind, SHAPED) else (drawn.shape,)
    return any(abs(_cosine(campaign, one, shape, true)) > LEAST_COSINE for shape in shapes)


def _cosine(campaign: CaseMotions, one: PlacedEntry, shape: float, true: Array) -> float:
    """Return the cosine of two changes, the second at the size that gives about the strength of the first."""
    strength = np.sqrt(max(information(true, true, campaign.nuisance), 0.0))
    size = one.entry.typical
    cosine = 0.0
    for _ in range(2):
        try:
            effect = one.entry.kind(campaign.plan.scene, one.place, size * one.scale, shape)
            change = _close_change(campaign, effect, true)
        except FloatingPointError:
            return 0.0
        if change is None:
            return 0.0
        own = np.sqrt(max(information(change, change, campaign.nuisance), 0.0))
        cosine = information(change, true, campaign.nuisance) / max(own * strength, 1e-12)
        size = min(size * float(np.clip(strength / max(own, 1e-9), 0.1, 10.0)), one.entry.high)
    return float(cosine)


def _close_change(campaign: CaseMotions, effect: TrueEffect, true: Array) -> Array | None:
    """Return the change by an effect; None if its cosine with the true one is below FAR.

    What some motions leave of the true change is a lower bound of what all leave: most effects need only few.
    """
    n_motions = len(campaign.fitted)
    parts = true.reshape(n_motions, -1)
    allowed = (1.0 - FAR**2) * information(true, true, campaign.nuisance)
    columns = campaign.nuisance.columns.reshape(n_motions, parts.shape[1], -1)
    order, changes = np.argsort(-np.sum(parts**2, axis=1)), np.zeros_like(parts)
    for count, motion in enumerate(order, 1):
        changes[motion] = change_of(campaign, effect, [motion])
        seen = order[:count]
        nuisance = make_nuisance(np.concatenate(columns[seen]))
        one, other = changes[seen].ravel(), parts[seen].ravel()
        imitated = information(one, other, nuisance) ** 2 / max(information(one, one, nuisance), 1e-12)
        if information(other, other, nuisance) - imitated > allowed:
            return None
    return np.asarray(changes.ravel())

"""Sentences of a diagnosis."""

import math
from collections.abc import Sequence
from enum import StrEnum
from math import isfinite
from typing import Final

from simgap.common.console import pluralize
from simgap.effects.effect import Family
from simgap.result import Base, Diagnosis, Finding, JointError, Remainder
from simgap.units import quantity

MAX_MEMBERS: Final = 3
"""Largest number of members of a set that is listed; a reader can act on no more of them."""
EARLIER: Final = "earlier result"
"""What errors count from with a start, in place of the model."""
NOT_LOCATED: Final = "something that is not located"
MUCH: Final = 2.0
"""Error over noise from which the first line says what is left: half of it or more is no noise."""
FAMILY_WORDS: Final[dict[StrEnum, str]] = {
    Family.FRICTION: "friction",
    Family.TRANSMISSION: "transmission",
    Family.ACTUATION: "actuation",
    Family.TIMING: "sensing or timing",
    Family.GEOMETRY: "geometry",
    Family.INERTIA: "inertia",
    Family.CONTACT: "contact",
    Family.EXTERNAL: "external torque",
}


def verdict_lines(diagnosis: Diagnosis) -> tuple[str, str, str, str]:
    """Return where, which effect and how sure, how far the error shrinks, and what to record next."""
    return (
        f"Where: {_where(diagnosis)}",
        f"What: {_what(diagnosis)}",
        f"How far: {_how_far(diagnosis)}",
        f"Next: {_next(diagnosis)}",
    )


def verdict_word(diagnosis: Diagnosis) -> str:
    """Return "named", "set", "none" or "unknown": one word for programs."""
    if not diagnosis.findings:
        return "unknown" if diagnosis.remaining or diagnosis.is_base_only else "none"
    if not all(finding.effects and finding.places for finding in diagnosis.findings):
        return "unknown"
    return "named" if all(len(finding.effects) == 1 for finding in diagnosis.findings) else "set"


def level(finding: Finding) -> str:
    """Return the level at which a finding is known: "effect", "family", "place" or "none"."""
    if len(finding.places) > MAX_MEMBERS:
        return "none"
    if 1 <= len(finding.effects) <= MAX_MEMBERS:
        return "effect"
    return "family" if 1 <= len(finding.families) <= MAX_MEMBERS else "place"


def finding_words(finding: Finding) -> str:
    """Return a finding as a noun with its place, at the level at which it is known."""
    found = level(finding)
    if found == "none":
        return NOT_LOCATED
    place = join_words(finding.places or (finding.place,), "or")
    if found == "effect":
        if len(finding.effects) == 1:
            return f"{finding.effect} at {finding.place} ({finding.text})"
        return _effects_words(finding.effects)
    if found == "family":
        kinds = join_words([FAMILY_WORDS[family] for family in finding.families], "or")
        return f"{kinds} at {place}"
    return f"something at {place}"


def has_floor(diagnosis: Diagnosis) -> bool:
    """Return whether repeats show the noise floor of every judged joint."""
    return all(one.noise_floor > 0.0 for one in diagnosis.errors)


def regime_words(regime: str) -> str:
    """Return a regime as part of a sentence."""
    kinds = ("slow", "fast", "all motion")
    return f"in {regime.removesuffix(' motion')} motion" if regime in kinds else regime


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{100 * share:.0f} %"


def join_words(words: Sequence[str], last: str, most: int = MAX_MEMBERS) -> str:
    """Join words by commas and a last conjunction; words beyond `most` are counted."""
    shown = list(dict.fromkeys(words))
    if len(shown) > most:
        shown = [*shown[:most], f"{len(shown) - most} more"]
        last = "and"
    if len(shown) < 2:
        return "".join(shown)
    return f"{', '.join(shown[:-1])} {last} {shown[-1]}"


def _where(diagnosis: Diagnosis) -> str:
    much = _much_left(diagnosis.errors)
    if diagnosis.is_base_only:
        return f"no effect was looked for{much and f'; base parameters leave {much}'}."
    located = [finding for finding in rank_findings(diagnosis) if level(finding) != "none"]
    words = [join_words(finding.places or (finding.place,), "or") for finding in located]
    if len(located) < len(diagnosis.findings):
        words.append(NOT_LOCATED)
    if not words:
        words = list(dict.fromkeys(one.place for one in list_differing(diagnosis)))
    elsewhere = [one.joint for one in (_much_remaining(diagnosis) if words else diagnosis.remaining)]
    if not words and not elsewhere:
        if any(math.isnan(one.noise_floor) for one in diagnosis.errors):
            return "nowhere; without repeated motions nobody knows if what remains is more than noise."
        return "nowhere; robot and model agree once the base parameters are fitted."
    rest = much and f", {much}"
    if not words:
        return f"{join_words(elsewhere, 'and')}{rest}."
    more = f" Something more remains at {join_words(elsewhere, 'and')}{rest}." if elsewhere else ""
    return f"{join_words(words, 'and')}.{more}"


def _much_remaining(diagnosis: Diagnosis) -> list[Remainder]:
    """Return what remains beyond MUCH times the noise, or beside a noise that is not known."""
    noise = {(one.joint, one.unit): one.noise_floor for one in diagnosis.errors}
    floors = [(one, noise.get((one.joint, one.unit), math.nan)) for one in diagnosis.remaining]
    return [one for one, floor in floors if not one.mean_abs <= MUCH * floor]


def _much_left(errors: Sequence[JointError]) -> str:
    """Return the error that is the most times its noise, with its joint, if over twice; else nothing."""
    known = [one for one in errors if one.noise_floor > 0.0]
    worst = max(known, key=lambda one: one.explained / one.noise_floor, default=None)
    if worst is None or worst.explained <= MUCH * worst.noise_floor:
        return ""
    left, times = quantity(worst.explained, worst.unit), worst.explained / worst.noise_floor
    return f"{left} at {worst.joint}, which is {times:{'.2g' if times < 100.0 else '.0f'}} times the noise"


def rank_findings(diagnosis: Diagnosis) -> list[Finding]:
    """Return the findings, first that which explains the most of the largest error."""
    largest: dict[str, float] = {}
    for one in diagnosis.errors:
        largest[one.kind] = max(largest.get(one.kind, 0.0), one.base)
    errors = {
        (one.joint, one.kind or diagnosis.kinds[0]): one.base / (largest[one.kind] or 1.0)
        for one in diagnosis.errors
    }
    effects = (effect.key for effect in diagnosis.effects)
    kinds = dict(zip(effects, diagnosis.effect_kinds, strict=False))

    def weight(one: Finding) -> float:
        share = one.share if isfinite(one.share) else 0.0
        kind = kinds.get(f"{one.place}: {one.effect}", diagnosis.kinds[0])
        return share * errors.get((one.place, kind), 1.0)

    return sorted(diagnosis.findings, key=weight, reverse=True)


def _what(diagnosis: Diagnosis) -> str:
    if not diagnosis.findings:
        base = join_words(
            [base_words(one, bool(diagnosis.start)) for one in list_differing(diagnosis)], "and"
        )
        if diagnosis.is_base_only:
            return f"{base or 'no base parameter accounts for half of the error of its joint'}."
        explains = " explains what remains" if diagnosis.remaining else ""
        return f"{f'{base}; ' if base else ''}none of the effects in the catalogue{explains}."
    ranked = rank_findings(diagnosis)
    shown = ranked[:MAX_MEMBERS]
    groups: dict[str, dict[str, bool]] = {}
    for one in shown:
        groups.setdefault(certainty_words(one), {})[finding_words(one)] = bool(one.families)
    texts = [
        f"{'; '.join(words)}, {'each ' if len(words) > 1 and all(words.values()) else ''}{certainty}"
        for certainty, words in groups.items()
    ]
    rest = len(ranked) - len(shown)
    first = "mainly " if rest > 0 else ""
    return first + "; ".join(texts) + (f"; and {pluralize(rest, 'more finding')}." if rest > 0 else ".")


def list_differing(diagnosis: Diagnosis) -> list[Base]:
    """Return the base parameters that differ from the model, first that which accounts for most."""
    found = [one for one in diagnosis.base if one.differs]
    return sorted(found, key=lambda one: -one.share if isfinite(one.share) else 0.0)


def base_words(one: Base, has_start: bool = False) -> str:
    """Return a base parameter as fitted, beside the number of the model or of an earlier result."""
    if one.name.endswith("_ratio"):
        before = f", in the {EARLIER} by {100 * one.nominal:+.3g} %" if has_start else ""
        return f"{one.name} of {one.place} differs from the model by {100 * one.value:+.3g} %{before}"
    before = EARLIER if has_start else "model"
    return f"{one.name} of {one.place} is {one.value:.3g}, in the {before} {one.nominal:.3g}"


def certainty_words(finding: Finding) -> str:
    """Return how sure a finding is, by the size of its sets."""
    found = level(finding)
    if found == "none":
        return "its place cannot be told"
    if found == "effect" and len(finding.effects) == 1:
        if len(finding.families) > 1:
            kinds = join_words([FAMILY_WORDS[family] for family in finding.families], "or")
            return f"95 % sure; its cause may be {kinds}"
        return "95 % sure: no other effect explains it"
    if found == "effect":
        return "95 % sure that it is one of these; they cannot be told apart"
    if not finding.families:
        return "no effect in the catalogue is known to cause it"
    if found == "family":
        return "95 % sure of the kind; its effects cannot be told apart"
    return "95 % sure of the place; its kinds of effects cannot be told apart"


def _effects_words(keys: Sequence[str]) -> str:
    """Return keys "place: name" as text, the place once if it is the same."""
    pairs = [key.split(": ", 1) for key in keys]
    places = {place for place, *_ in pairs}
    if len(places) == 1:
        return f"{join_words([pair[-1] for pair in pairs], 'or')} at {places.pop()}"
    return join_words([f"{name} at {place}" for place, name in pairs], "or")


def _how_far(diagnosis: Diagnosis) -> str:
    """Return the error of the joint with the largest one, with and without findings, beside its noise.

    Errors of different units are compared by their noise, with base parameters fitted.
    """
    if not diagnosis.judged_motions or not diagnosis.errors:
        return "not known, because no motion was held out."
    motions = pluralize(len(diagnosis.judged_motions), "motion")
    is_mixed = has_floor(diagnosis) and len({each.unit for each in diagnosis.errors}) > 1
    one = max(diagnosis.errors, key=lambda each: each.base / each.noise_floor if is_mixed else each.nominal)
    known = one.noise_floor > 0.0
    noise = f"noise: {quantity(one.noise_floor, one.unit)}" if known else "noise: not known without repeats"
    before = f" with the {EARLIER}" if diagnosis.start else ""
    steps = f"{quantity(one.nominal, one.unit)}{before}; with base parameters {quantity(one.base, one.unit)}"
    found = bool(diagnosis.findings)
    steps += f"; with the findings {quantity(one.explained, one.unit)}" if found else ""
    far = f"on {motions} that took no part, the error of {one.joint} is {steps} ({noise})"
    if not found or not one.base > 0.0:
        return f"{far}."
    share = 1.0 - one.explained / one.base
    verb = "take" if share >= 0.0 else "add"
    return f"{far}. The findings {verb} {percent(abs(share))} of what base parameters left."


def _next(diagnosis: Diagnosis) -> str:
    wanted = next((one.next_motion for one in diagnosis.findings if one.next_motion), "")
    if wanted:
        return f"record {wanted}."
    pairs = [one.effects for one in diagnosis.findings if level(one) == "effect" and len(one.effects) > 1]
    if pairs:
        return (
            f"no recorded motion tells {_effects_words(pairs[0])} apart above the noise; record one that is "
            "faster, slower, with another load or without torque."
        )
    if not diagnosis.judged_motions:
        return "hold out some motions, so that the result can be judged."
    if diagnosis.is_base_only:
        return "look for effects: diagnose with the whole catalogue."
    if not has_floor(diagnosis):
        return "repeat some motions without a change, so that the noise floor is known."
    remaining = _much_remaining(diagnosis)
    if remaining:
        one = max(remaining, key=lambda each: each.depends_share)
        if one.depends_on:
            return f"write an effect of your own at {one.joint} that depends on {one.depends_on}."
        return f"log more of {one.joint}, such as torque, temperature or a second encoder."
    if diagnosis.remaining:
        return "nothing; what remains is less than twice the noise."
    return "nothing; these motions leave no question open."

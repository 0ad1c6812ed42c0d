"""JSON document of a diagnosis: every number, with plain keys, and units in the keys or beside the values."""

from collections.abc import Mapping, Sequence
from math import isfinite, isinf, nan
from typing import Any, Final

from diagnosis.effects.effect import Effect, Family
from diagnosis.errors import RobotError
from diagnosis.report.sentences import detail_lines, verdict_lines, verdict_word
from diagnosis.result import Base, Diagnosis, Finding, JointError, Refusal, Rejected, Remainder

FORMAT: Final = "diagnosis 1"
"""Name and version of the document."""


def to_document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as a document that JSON can hold; unknown numbers are null."""
    return {
        "format": FORMAT,
        "robot": diagnosis.robot,
        "kind": diagnosis.kind,
        "seed": diagnosis.seed,
        "verdict": verdict_word(diagnosis),
        "lines": list(verdict_lines(diagnosis)),
        "details": detail_lines(diagnosis),
        "closure_share": diagnosis.closure,
        "findings": [_finding(one) for one in diagnosis.findings],
        "base": [_base(one) for one in diagnosis.base],
        "errors": [_error(one) for one in diagnosis.errors],
        "remaining": [_remainder(one) for one in diagnosis.remaining],
        "refused": [
            {"motion": one.motion, "reason": one.reason, "n_samples": one.n_samples}
            for one in diagnosis.refused
        ],
        "rejected": [
            {"place": one.place, "effect": one.effect, "reason": one.reason} for one in diagnosis.rejected
        ],
        "fitted_motions": list(diagnosis.fitted_motions),
        "judged_motions": list(diagnosis.judged_motions),
        "effects": [
            {
                "key": effect.key,
                "size": {one.name: number(value) for one, value in zip(effect.sizes, size, strict=True)},
            }
            for effect, size in zip(diagnosis.effects, diagnosis.sizes, strict=True)
        ],
    }


def from_document(document: Mapping[str, Any], catalogue: Sequence[Effect]) -> Diagnosis:
    """Return the diagnosis of a document.

    Args:
        document: Document as `to_document` makes it.
        catalogue: Effects of the robot, among which those of the document are found by their keys.

    Raises:
        RobotError: The document has another format, or an effect that the catalogue does not have.
    """
    if document.get("format") != FORMAT:
        raise RobotError(f"the document says format {document.get('format')!r}; {FORMAT!r} would be right")
    known = {effect.key: effect for effect in catalogue}
    unknown = [one["key"] for one in document["effects"] if one["key"] not in known]
    if unknown:
        raise RobotError(f"the catalogue has no {unknown[0]!r}; give the file of effects it came from")
    return Diagnosis(
        robot=document["robot"],
        kind=document["kind"],
        seed=document["seed"],
        findings=tuple(_read_finding(one) for one in document["findings"]),
        base=tuple(_read_base(one) for one in document["base"]),
        errors=tuple(_read_error(one) for one in document["errors"]),
        remaining=tuple(_read_remainder(one) for one in document["remaining"]),
        refused=tuple(Refusal(one["motion"], one["reason"], one["n_samples"]) for one in document["refused"]),
        rejected=tuple(Rejected(**one) for one in document["rejected"]),
        fitted_motions=tuple(document["fitted_motions"]),
        judged_motions=tuple(document["judged_motions"]),
        effects=tuple(known[one["key"]] for one in document["effects"]),
        sizes=tuple(tuple(map(value, one["size"].values())) for one in document["effects"]),
    )


def number(value_or_not: float) -> float | str | None:
    """Return a number as JSON can hold it: NaN is null, infinity a text."""
    if isinf(value_or_not):
        return "inf" if value_or_not > 0 else "-inf"
    return float(value_or_not) if isfinite(value_or_not) else None


def value(written: float | str | None) -> float:
    """Return the number that `number` has written."""
    return nan if written is None else float(written)


def _finding(one: Finding) -> dict[str, Any]:
    sizes = zip(one.size_names, one.size, one.interval, strict=True)
    return {
        "place": one.place,
        "family": str(one.family),
        "effect": one.effect,
        "text": one.text,
        "sizes": [
            {"name": name, "value": number(size), "low_90": number(low), "high_90": number(high)}
            for name, size, (low, high) in sizes
        ],
        "share": number(one.share),
        "not_excluded": {
            "places": list(one.places),
            "families": [str(family) for family in one.families],
            "effects": list(one.effects),
        },
        "next_motion": one.next_motion,
    }


def _read_finding(table: Mapping[str, Any]) -> Finding:
    sizes, left = table["sizes"], table["not_excluded"]
    return Finding(
        place=table["place"],
        family=Family(table["family"]),
        effect=table["effect"],
        size=tuple(value(one["value"]) for one in sizes),
        size_names=tuple(one["name"] for one in sizes),
        interval=tuple((value(one["low_90"]), value(one["high_90"])) for one in sizes),
        text=table["text"],
        share=value(table["share"]),
        places=tuple(left["places"]),
        families=tuple(map(Family, left["families"])),
        effects=tuple(left["effects"]),
        next_motion=table["next_motion"],
    )


def _base(one: Base) -> dict[str, Any]:
    low, high = one.interval
    return {
        "place": one.place,
        "name": one.name,
        "nominal": number(one.nominal),
        "value": number(one.value),
        "low_90": number(low),
        "high_90": number(high),
        "is_identifiable": one.is_identifiable,
    }


def _read_base(table: Mapping[str, Any]) -> Base:
    return Base(
        table["place"],
        table["name"],
        value(table["nominal"]),
        value(table["value"]),
        (value(table["low_90"]), value(table["high_90"])),
        table["is_identifiable"],
    )


def _error(one: JointError) -> dict[str, Any]:
    return {
        "joint": one.joint,
        "unit": one.unit,
        "nominal": number(one.nominal),
        "base": number(one.base),
        "explained": number(one.explained),
        "noise_floor": number(one.noise_floor),
    }


def _read_error(table: Mapping[str, Any]) -> JointError:
    levels = (value(table[name]) for name in ("nominal", "base", "explained", "noise_floor"))
    return JointError(table["joint"], table["unit"], *levels)


def _remainder(one: Remainder) -> dict[str, Any]:
    return {
        "joint": one.joint,
        "regime": one.regime,
        "mean_abs": number(one.mean_abs),
        "unit": one.unit,
        "depends_on": one.depends_on,
        "depends_share": number(one.depends_share),
    }


def _read_remainder(table: Mapping[str, Any]) -> Remainder:
    return Remainder(
        table["joint"],
        table["regime"],
        value(table["mean_abs"]),
        table["unit"],
        table["depends_on"],
        value(table["depends_share"]),
    )

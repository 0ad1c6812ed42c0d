"""Score as a JSON document and as a Markdown page."""

import json
from collections.abc import Iterator
from dataclasses import asdict, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from marsarm.common.rates import Rate
from simgap.common.files import atomic_write
from validation.blind.score import DetectionRates, Median, OutsideRates, Score


def score_json(score: Score) -> dict[str, Any]:
    """Return the JSON document; NaN and infinity are None."""
    document: dict[str, Any] = plain(score)
    return document


def score_markdown(score: Score) -> str:
    """Return the Markdown page."""
    return "\n".join(_lines(score)) + "\n"


def save_score(score: Score, path: Path) -> None:
    """Write JSON or Markdown by the suffix of the path; BadOutput if it cannot be written."""
    text = json.dumps(score_json(score), indent=1) + "\n" if path.suffix == ".json" else score_markdown(score)
    with atomic_write(path, "out") as file:
        file.write(text.encode())


def _lines(score: Score) -> Iterator[str]:
    found = score.found
    yield f"# {score.cases} blind cases"
    yield "Intervals are exact, 95 %. Effects count from the limit of the selection on, by equivalence class."
    yield ""
    yield "| | wanted | found |"
    yield "|---|---|---|"
    yield f"| no effect called one | 9 % or fewer | {rate_text(score.false_alarm)} |"
    yield f"| reported | 85 % | {rate_text(found.reported)} |"
    yield f"| right place, of those | 95 % | {rate_text(found.place)} |"
    yield f"| right effect as first choice, of those | 88 % | {rate_text(found.effect)} |"
    yield f"| in the set of the level that was reported | 95 % | {rate_text(found.covered)} |"
    yield f"| effects in a set that names effects, mean | | {score.set_size:.2f} |"
    yield f"| members of the largest set | 3 | {score.most_members} |"
    yield f"| named, but not of the case | | {rate_text(score.spurious)} |"
    yield f"| 90 % intervals that cover | 85 to 95 % | {rate_text(score.interval)} |"
    yield f"| closure, median | | {_median_text(score.closure)} |"
    yield f"| what the true effects achieve | | {_median_text(score.true_closure)} |"
    yield f"| lost against that, median | 5 points or fewer | {_median_text(score.closure_lost)} |"
    yield f"| CPU seconds for a case, median | 10 or fewer | {score.seconds.median:.1f} |"
    yield f"| the longest | | {score.max_seconds:.1f} |"
    yield from ("", "## Outside the catalogue", "")
    yield "In brackets counts, then 95 % by a bootstrap over effects."
    yield ""
    yield "| | all | related | unrelated |"
    yield "|---|---|---|---|"
    parts = (score.outside, score.related, score.unrelated)
    for level, bar in (("place", 8), ("family", 14), ("effect", 20)):
        cells = " | ".join(_outside_text(one, level) for one in parts)
        yield f"| wrong {level}, {bar} % or fewer | {cells} |"
    yield f"| something is reported | {' | '.join(rate_text(one.reported) for one in parts)} |"
    yield from ("", "## By size", "")
    yield "| detection limits | reported | right place | right effect | in the set |"
    yield "|---|---|---|---|---|"
    for one in score.bins:
        yield f"| {one.least:g} to {one.most:g} | {_detection_cells(one.found)} |"
    yield from ("", "## Levels", "")
    names = ("size", "effect", "family", "place", "unlocated", "none", "unknown")
    yield f"| truth | {' | '.join(names)} |"
    yield "|---" * (len(names) + 1) + "|"
    for kind, row in score.levels.items():
        yield f"| {kind} | {' | '.join(str(row.get(level, 0)) for level in names)} |"


def _detection_cells(found: DetectionRates) -> str:
    return " | ".join(rate_text(one) for one in (found.reported, found.place, found.effect, found.covered))


def _outside_text(found: OutsideRates, level: str) -> str:
    rate: Rate = getattr(found, f"wrong_{level}")
    least, most = found.by_effect[level]
    if not rate.of:
        return "no case"
    return f"{100 * rate.share:.1f} % ({rate.hits} of {rate.of}; {100 * least:.1f} to {100 * most:.1f})"


def rate_text(rate: Rate) -> str:
    """Return a rate as text, with its counts and its interval."""
    if not rate.of:
        return "no case"
    between = f"{100 * rate.least:.1f} to {100 * rate.most:.1f}"
    return f"{100 * rate.share:.1f} % ({rate.hits} of {rate.of}; {between})"


def _median_text(middle: Median) -> str:
    if not middle.of:
        return "no case"
    ends = (middle.least, middle.most)
    between = f"{100 * ends[0]:.1f} to {100 * ends[1]:.1f}" if all(map(isfinite, ends)) else "too few to say"
    return f"{100 * middle.median:.1f} % (of {middle.of}; {between})"


def plain(value: Any) -> Any:
    """Return a value as JSON holds it: records as tables, NaN and infinity as None."""
    if isinstance(value, Rate):
        return {**asdict(value), "share": plain(value.share)}
    if is_dataclass(value) and not isinstance(value, type):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value

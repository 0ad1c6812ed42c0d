"""Score as a JSON document and as a Markdown page."""

import json
from collections.abc import Iterator
from dataclasses import asdict, is_dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from ground.common.files import atomic_write
from ground.common.rates import Rate
from validation.blind.score import DetectionRates, Median, Score


def score_json(score: Score) -> dict[str, Any]:
    """Return the JSON document; NaN and infinity are None."""
    document: dict[str, Any] = _plain(score)
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
    yield f"# {score.cases} blind cases"
    yield "Intervals are exact, 95 %. Effects count from the detection limit on, by equivalence class."
    yield ""
    yield "| | wanted | found |"
    yield "|---|---|---|"
    yield f"| no effect called one | 5 % or fewer | {_rate_text(score.false_alarm)} |"
    yield f"| effect outside the catalogue given a name | 15 % or fewer | {_rate_text(score.wrong_name)} |"
    yield f"| right place | 90 % | {_rate_text(score.found.place)} |"
    yield f"| right effect as first choice | 80 % | {_rate_text(score.found.effect)} |"
    yield f"| in the reported set | 95 % | {_rate_text(score.found.in_set)} |"
    yield f"| right place, where a name or set was given | | {_rate_text(score.found_given.place)} |"
    yield f"| right effect, likewise | | {_rate_text(score.found_given.effect)} |"
    yield f"| in the reported set, likewise | | {_rate_text(score.found_given.in_set)} |"
    yield f"| classes in a set, mean | under 2 | {score.set_size:.2f} |"
    yield f"| named, but not of the case | | {_rate_text(score.spurious)} |"
    yield f"| 90 % intervals that cover | interval has 90 % | {_rate_text(score.covered)} |"
    yield f"| closure, median | 80 % or more | {_median_text(score.closure)} |"
    yield f"| what the true effects achieve | | {_median_text(score.true_closure)} |"
    yield f"| lost against that, median | 5 points or fewer | {_median_text(score.closure_lost)} |"
    yield f"| CPU seconds for a case, median | 15 or fewer | {score.seconds.median:.1f} |"
    yield f"| the longest | | {score.max_seconds:.1f} |"
    yield from ("", "## By size", "")
    yield "| detection limits | right place | right effect | in the set | outside: wrong name |"
    yield "|---|---|---|---|---|"
    for one in score.bins:
        cells = f"{_detection_cells(one.found)} | {_rate_text(one.wrong_name)}"
        yield f"| {one.least:g} to {one.most:g} | {cells} |"
    yield from ("", "## Others, with the same features", "")
    yield "| | right place | right effect | closure, median |"
    yield "|---|---|---|---|"
    yield (
        f"| this diagnosis | {_rate_text(score.found.place)} | {_rate_text(score.found.effect)} "
        f"| {_median_text(score.closure)} |"
    )
    for name, other in score.baselines.items():
        yield (
            f"| {name.replace('_', ' ')} | {_rate_text(other.place)} | {_rate_text(other.effect)} "
            f"| {_median_text(other.closure)} |"
        )
    yield from ("", "## Verdicts", "", "| truth | named | set | none | unknown |", "|---|---|---|---|---|")
    for kind, row in score.verdicts.items():
        cells = " | ".join(str(row.get(verdict, 0)) for verdict in ("named", "set", "none", "unknown"))
        yield f"| {kind} | {cells} |"
    yield from ("", "## Classes", "", "| members | classes |", "|---|---|")
    for members, count in score.class_sizes.items():
        yield f"| {members} | {count} |"


def _detection_cells(found: DetectionRates) -> str:
    return " | ".join(_rate_text(one) for one in (found.place, found.effect, found.in_set))


def _rate_text(rate: Rate) -> str:
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


def _plain(value: Any) -> Any:
    if isinstance(value, Rate):
        return {**asdict(value), "share": _plain(value.share)}
    if is_dataclass(value) and not isinstance(value, type):
        return {name: _plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not isfinite(value):
        return None
    return value

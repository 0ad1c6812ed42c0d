"""The campaign of the inverse kinematics: millions of targets and joint vectors, each answer checked.

A target is tried for what its answers do, a joint vector for whether it is among the answers to its target.
"""

import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

from validation.campaign import Chunk, Tally, plan, run
from validation.cases import CASES
from validation.options import parser

EXAMPLE = "example: python -m validation.kinematics --targets 200000 --vectors 200000 > campaign.json"
SAY_EVERY_S = 10.0


def campaign(n_targets: int, n_vectors: int, seed: int = 0, workers: int = 1) -> dict[str, Any]:
    """Run it and sum up, by case; with the same seed and numbers everything comes again."""
    began = time.monotonic()
    tallies = {case.name: Tally() for case in CASES}
    chunks = plan(n_targets, n_vectors, seed)
    said = began
    for done, (chunk, tally) in enumerate(_results(chunks, workers), 1):
        tallies[chunk.case.name].add(tally)
        now = time.monotonic()
        if now - said > SAY_EVERY_S or done == len(chunks):
            said = now
            _say(done, len(chunks), now - began, tallies)
    return {
        "seed": seed,
        "targets": sum(t.targets for t in tallies.values()),
        "vectors": sum(t.vectors for t in tallies.values()),
        "failures": sum(t.failures for t in tallies.values()),
        "workspace_share_with_at_most_four_valid": _share(tallies),
        "seconds": time.monotonic() - began,
        "cases": {
            case.name: {"tolerance": case.tolerance_m, **tallies[case.name].as_json()} for case in CASES
        },
    }


def _results(chunks: Sequence[Chunk], workers: int) -> Iterator[tuple[Chunk, Tally]]:
    """As they come; the order changes nothing but which examples are kept."""
    if workers == 1:
        yield from ((chunk, run(chunk)) for chunk in chunks)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        running = {pool.submit(run, chunk): chunk for chunk in chunks}
        for future in as_completed(running):
            yield running[future], future.result()


def _share(tallies: dict[str, Tally]) -> float:
    workspace = sum(t.workspace for t in tallies.values())
    return sum(t.workspace_at_most_four for t in tallies.values()) / max(workspace, 1)


def _say(done: int, of: int, spent_s: float, tallies: dict[str, Tally]) -> None:
    failures = sum(t.failures for t in tallies.values())
    left_s = spent_s / done * (of - done)
    print(f"marsarm: {done} of {of} chunks, {failures} failures, {left_s:.0f} s to go", file=sys.stderr)


def main() -> int:
    """Print the result as JSON; exit status 1 if anything failed."""
    options = parser("kinematics", __doc__, EXAMPLE)
    options.add_argument("--targets", type=int, default=200_000, help="random targets (default 200000)")
    options.add_argument("--vectors", type=int, default=200_000, help="random joint vectors (default 200000)")
    asked = options.parse_args()
    if min(asked.targets, asked.vectors, asked.workers) < 1 or asked.seed < 0:
        options.error("targets, vectors and workers are 1 or more, the seed is not negative")
    result = campaign(asked.targets, asked.vectors, asked.seed, asked.workers)
    print(json.dumps(result, indent=2))
    return 1 if result["failures"] else 0


if __name__ == "__main__":
    sys.exit(main())

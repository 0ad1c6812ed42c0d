"""Campaigns of the project: `python -m validation` lists them, `python -m validation NAME` runs one.

The exit status is 1 if a campaign is out of its bounds, and 2 if it cannot run.
"""

import argparse
import json
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from marsarm.common.pool import select_runner
from simgap.common.errors import UserError
from simgap.common.options import CLUSTER_HELP, CLUSTER_HERE
from simgap.common.progress import show_progress
from simgap.common.report import to_json
from validation.campaigns import TABLE, Campaign, Context, Document, find_campaign, read_sizes

EXAMPLE = "example: python -m validation hardstops --set arms=4 --set repeats=10 --json"


def main(words: list[str] | None = None) -> int:
    """List the campaigns, or run one; return the exit status."""
    parser = argparse.ArgumentParser("python -m validation", description=__doc__, epilog=EXAMPLE)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("name", nargs="?", help="campaign; all are listed if there is none")
    parser.add_argument("--brief", action="store_true", help="a minute of one core at most")
    parser.add_argument("--json", action="store_true", help="print the whole document")
    parser.add_argument("--workers", type=int, default=2, help="number of processes (default 2)")
    parser.add_argument("--cluster", nargs="?", const=CLUSTER_HERE, metavar="HOST:PORT", help=CLUSTER_HELP)
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default 0)")
    parser.add_argument("--out", type=Path, help="file of the document, or of what the list says")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", dest="sizes", help="a size; repeatable"
    )
    options = parser.parse_args(words)
    if options.name is None:
        print("\n".join(map(describe, TABLE)))
        return 0
    if options.workers < 1 or options.seed < 0:
        parser.error("workers are 1 or more, the seed is not negative")
    # A shell that starts a job in the background ignores SIGINT for it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return run(find_campaign(options.name), options)
    except UserError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def run(campaign: Campaign, options: Any) -> int:
    """Run a campaign and print its document, or its main numbers; return the exit status."""
    work = campaign.load()
    brief = campaign.brief or {} if options.brief else {}
    sizes = read_sizes(work, [*(f"{name}={value}" for name, value in brief.items()), *options.sizes])
    with show_progress(f"validation.{campaign.name}", str(sizes)) as progress:
        runner = select_runner(options.workers, options.cluster)
        kept = options.out if campaign.keeps else None
        context = Context(options.seed, runner, kept, progress, options.workers, options.cluster)
        document = to_json(work(context, **sizes))
    text = json.dumps(document, indent=2)
    if options.out is not None and not campaign.keeps:
        options.out.write_text(text + "\n", encoding="utf-8")
    print(text if options.json else "\n".join(summarize(document)))
    return 0 if document.get("in_bounds", True) else 1


def describe(campaign: Campaign) -> str:
    """Return the line of a campaign in the list."""
    notes = [f"--out: {campaign.keeps}"] if campaign.keeps else []
    notes += [f"needs {campaign.needs}"] if campaign.needs else []
    return "; ".join([f"{campaign.name:<16} {campaign.shows} ({campaign.takes})", *notes])


def summarize(document: Document, place: str = "", depth: int = 3) -> Iterator[str]:
    """Yield a line for each number and text of a document, without its lists."""
    for name, value in document.items():
        if isinstance(value, dict) and depth > 1:
            yield from summarize(value, f"{place}{name} / ", depth - 1)
        elif isinstance(value, float):
            yield f"{place}{name}: {value:.4g}"
        elif not isinstance(value, list | dict):
            yield f"{place}{name}: {value}"


if __name__ == "__main__":
    sys.exit(main())

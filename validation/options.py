"""Command-line options that all campaigns share."""

import argparse
import sys
from typing import Any

from marsarm.common.pool import Runner, select_runner
from simgap.common.errors import BadRequest
from simgap.common.options import CLUSTER_HELP, CLUSTER_HERE


def campaign_parser(
    name: str, description: Any, example: str, with_pool: bool = True
) -> argparse.ArgumentParser:
    """Make the parser of `python -m validation.NAME`, with the options that all campaigns share.

    Args:
        name: Name of the module.
        description: Text of the help.
        example: Last line of the help.
        with_pool: Whether the user chooses where the jobs run.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m validation.{name}",
        description=description,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if with_pool:
        parser.add_argument("--workers", type=int, default=2, help="number of processes (default 2)")
        parser.add_argument(
            "--cluster", nargs="?", const=CLUSTER_HERE, metavar="HOST:PORT", help=CLUSTER_HELP
        )
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default 0)")
    return parser


def campaign_runner(options: argparse.Namespace) -> Runner:
    """Make the runner of the options `--workers` and `--cluster`; exit with 2 if there is none."""
    if options.workers < 1:
        sys.exit(_refuse("workers are 1 or more"))
    try:
        return select_runner(options.workers, options.cluster)
    except BadRequest as error:
        sys.exit(_refuse(str(error)))


def _refuse(sentence: str) -> int:
    print(sentence, file=sys.stderr)
    return 2

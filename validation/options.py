"""Command-line options that all campaigns share."""

import argparse
from typing import Any


def campaign_parser(name: str, description: Any, example: str) -> argparse.ArgumentParser:
    """Make the parser of `python -m validation.NAME`, with the options that all campaigns share."""
    parser = argparse.ArgumentParser(
        prog=f"python -m validation.{name}",
        description=description,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--workers", type=int, default=2, help="number of processes (default 2)")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default 0)")
    return parser

"""Options that all campaigns have on the command line."""

import argparse
from typing import Any


def campaign_parser(name: str, what: Any, example: str) -> argparse.ArgumentParser:
    """Make the parser of `python -m validation.NAME`, with the options that all have."""
    options = argparse.ArgumentParser(
        prog=f"python -m validation.{name}",
        description=what,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    options.add_argument("--seed", type=int, default=0, help="of everything random (default 0)")
    return options

"""Helper that runs the command line in a separate process, as a user does."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def marsarm(
    folder: Path, *words: str, before: str = "", **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run the command line of this tree, not an installed one, until it exits.

    Args:
        folder: Working directory.
        *words: Arguments of `marsarm`.
        before: Python code that runs first in its process.
        **variables: Environment variables.
    """
    command = [sys.executable, "-c", f"{before}\nfrom ground.cli.app import main; main()", *words]
    env = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    return subprocess.run(
        command, cwd=folder, env=env, capture_output=True, text=True, timeout=300, check=False
    )

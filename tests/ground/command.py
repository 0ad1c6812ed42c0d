"""The command line in a process of its own, as a user starts it."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def marsarm(
    folder: Path, *words: str, before: str = "", **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder to its end; it is the command of this tree, whatever is installed.

    What is to be done in its process before is Python.
    """
    command = [sys.executable, "-c", f"{before}\nfrom ground.cli.app import main; main()", *words]
    env = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    return subprocess.run(
        command, cwd=folder, env=env, capture_output=True, text=True, timeout=300, check=False
    )

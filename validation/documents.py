"""Commands and Python blocks of the documents, run as they stand, in order and in one folder."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document

ROOT: Final = Path(__file__).resolve().parents[1]
PAGES: Final = (
    *("README", "simgap/README", "docs/commands", "docs/run", "docs/arms", "docs/logs", "docs/effects"),
    *("docs/accuracy", "docs/calibration", "docs/diagnosis", "docs/simgap", "docs/robot-file"),
    *("docs/robot-effects", "docs/method", "docs/python", "docs/flight-software", "docs/frames"),
)
"""Pages in their order. Others have campaigns, which `make campaign` runs, or steps of a developer."""
BLOCK: Final = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NAMED: Final = re.compile(r"# ([\w-]+\.toml)\b")
"""Opening of a block that is the content of a file."""
PROGRAMS: Final = ("marsarm ", "simgap ", "python ")
PLACEHOLDER: Final = re.compile(r"\b[A-Z]{3,}\b|\bmy-arm\b|--install-completion")
"""What stands for a file of the reader, so that the command shows a form."""
MACHINES: Final = "the cluster needs two machines"
LEFT_OUT: Final = {
    "make ": "`.ci/run` sets up, tests and lints",
    ". .venv/bin/activate": "the test runs in the environment",
    "pip ": "changes the environment; tests/test_package.py installs the wheels",
    "export ": MACHINES,
    "ray ": MACHINES,
    "marsarm monte-carlo --case mars --arms 10000 --results mars.jsonl --cluster": MACHINES,
}
"""Command, or its first word with a space -> why it is not run."""
QUICK: Final = (
    *("marsarm dictionary", "marsarm run --list", "marsarm ik", "simgap init"),
    *("simgap check", "simgap diagnose tracker", "python examples/samples", "import numpy as np"),
)
"""Beginnings of commands that take seconds and need nothing of longer ones: the short tests run them."""
LONGER: Final = ("run.mcap", "from simgap")
"""What a Python block has that needs the log of a command of minutes, or a whole diagnosis."""
SLOW: Final = ("simgap diagnose servo/robot.toml servo/log.csv --held-out 6 --held-out 7 --terms none",)
"""Commands that the slow tests run, too. The campaign runs the others, which take minutes."""
ANSWERS_NO: Final = ("marsarm replay run.mcap --params softer.toml --json",)
"""Commands that end with status 3, as their page says; the others end with 0."""


@dataclass(frozen=True, slots=True)
class Step:
    """Command, Python block, or block that is a file."""

    page: str
    kind: str
    """sh, python or file."""
    text: str
    file: str = ""
    """Name of the file that the block is."""

    @property
    def tier(self) -> str:
        """Return who runs it: quick, slow or campaign."""
        if self.kind == "file" or self.text.startswith(QUICK):
            return "quick"
        is_longer = any(one in self.text for one in LONGER)
        is_slow = self.text.startswith(SLOW) or (self.kind == "python" and not is_longer)
        return "slow" if is_slow else "campaign"


def read_steps() -> list[Step]:
    """Return what is run, each text once: of each page first its blocks, then the commands in its lines."""
    found: dict[tuple[str, str], Step] = {}
    for page in PAGES:
        for step in read_page(page):
            if not why_left_out(step):
                found.setdefault((step.kind, step.text), step)
    return list(found.values())


def read_page(page: str) -> Iterator[Step]:
    """Yield the steps of a page, its files first, with those that are not run."""
    text = (ROOT / f"{page}.md").read_text(encoding="utf-8")
    blocks = BLOCK.findall(text)
    yield from (Step(page, "file", block, named[1]) for _, block in blocks if (named := NAMED.match(block)))
    for language, block in blocks:
        if language == "python":
            yield Step(page, "python", block)
        elif language == "sh":
            lines = (re.sub(r"\s+#.*", "", line) for line in block.splitlines())
            yield from (Step(page, "sh", line) for line in lines if line)
    for line in re.findall(r"`([^`\n]+)`", BLOCK.sub("", text)):
        if line.startswith(PROGRAMS) and len(line.split()) > 2:  # else it names a verb
            yield Step(page, "sh", line)


def why_left_out(step: Step) -> str:
    """Return why a step is not run; empty if it is."""
    if step.kind != "sh":
        return ""
    if PLACEHOLDER.search(step.text):
        return "shows a form"
    return LEFT_OUT.get(step.text) or LEFT_OUT.get(f"{step.text.partition(' ')[0]} ", "")


def make_folder(folder: Path) -> None:
    """Make a folder that looks like a clone; models are a copy, as commands may write there."""
    for name in ("docs", "examples", "simgap", "sim", "fsw", "marsarm", "validation", "pyproject.toml"):
        (folder / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "models", folder / "models")


def run_step(step: Step, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a step, as a reader would in a shell or in Python; the cache is in the folder."""
    if step.kind == "file":
        (folder / step.file).write_text(step.text, encoding="utf-8")
        return subprocess.CompletedProcess([], 0, "", "")
    env = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "XDG_CACHE_HOME": str(folder / "cache"),
        "MPLBACKEND": "agg",
    }
    words = ["bash", "-euc", step.text]
    if step.kind == "python":
        words = [sys.executable, "-W", "error", "-c", step.text]
    return subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True, check=False)


def campaign(context: Context) -> Document:
    """Run all steps in the folder `out`, or in one that is deleted, and return those that failed."""
    if context.out is not None and context.out.exists():
        raise BadRequest(f"out {context.out}: exists; name a folder that does not")
    steps, failed = read_steps(), []
    with TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        folder = context.out or Path(scratch, "clone")
        folder.mkdir(parents=True)
        make_folder(folder)
        for k, step in enumerate(steps):
            context.progress(k, len(steps), step.text.partition("\n")[0])
            done = run_step(step, folder)
            if done.returncode != (3 if step.text in ANSWERS_NO else 0):
                failed.append({"page": step.page, "text": step.text, "said": done.stderr[-1000:]})
    return {"steps": len(steps), "failed": failed, "in_bounds": not failed}

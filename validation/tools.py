"""Campaigns that run other programs: mutants of the protection, and the scripts of examples/."""

import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document

ROOT: Final = Path(__file__).parents[1]
LEAST_KILLED: Final = 0.95
KILLED: Final = ("killed", "timeout")
"""What mutmut calls a mutant that the tests notice."""


def mutants(context: Context) -> Document:
    """Change fsw/protect in a thousand places, one at a time; count the changes that its tests notice."""
    program = Path(sys.executable).with_name("mutmut")
    if not program.exists():
        raise BadRequest("mutmut is not installed; pip install 'mutmut>=3.8'")
    shutil.rmtree(ROOT / "mutants", ignore_errors=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(program), "run", "--max-children", str(context.workers)]
    subprocess.run(words, cwd=ROOT, env=environment, stdout=sys.stderr, check=False)
    listed = subprocess.run(
        [str(program), "results", "--all", "true"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    # fsw.protect.monitors.x_check__mutmut_3: killed
    rows = [line.strip().rpartition(": ") for line in listed.stdout.splitlines() if ": " in line]
    every = Counter(name.split(".")[2] for name, _, _ in rows)
    killed = Counter(name.split(".")[2] for name, _, end in rows if end in KILLED)
    return {
        "files": {f"{name}.py": f"{killed[name]}/{count}" for name, count in sorted(every.items())},
        "killed": killed.total(),
        "of": every.total(),
        "alive": [f"{name}: {end}" for name, _, end in rows if end not in KILLED],
        "in_bounds": killed.total() >= LEAST_KILLED * every.total() > 0.0,
    }


def examples(context: Context) -> Document:
    """Run all scripts in a folder that is deleted, and keep their pictures."""
    scripts = sorted((ROOT / "examples").glob("*.py"))
    failed = []
    with TemporaryDirectory() as folder:
        for number, script in enumerate(scripts):
            context.progress(number, len(scripts), script.stem)
            ran = subprocess.run([sys.executable, str(script)], cwd=folder, stdout=sys.stderr, check=False)
            failed += [script.name] if ran.returncode else []
        pictures = sorted(Path(folder).glob("*.png"))
        if context.out is not None:
            context.out.mkdir(parents=True, exist_ok=True)
            for picture in pictures:
                shutil.copy(picture, context.out)
    return {"scripts": len(scripts), "pictures": len(pictures), "failed": failed, "in_bounds": not failed}

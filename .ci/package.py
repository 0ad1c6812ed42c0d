"""Build the source distributions of both products from a copy of the tree, and the wheels from these.

`python .ci/package.py FOLDER` writes all four to a folder. No file of an earlier build can get into them.
"""

import sys
import tarfile
from contextlib import chdir
from pathlib import Path
from shutil import copytree, ignore_patterns
from tempfile import TemporaryDirectory
from typing import Final

from setuptools import build_meta

ROOT: Final = Path(__file__).resolve().parents[1]
PRODUCTS: Final = ("simgap", ".")
"""Folders with a `pyproject.toml`."""
NOT_SOURCE: Final = (".*", "*.egg-info", "__pycache__", "build", "dist", "out", "mutants", "*-cases-*")


def main(folder: Path) -> None:
    """Write the source distributions and the wheels to a folder."""
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        tree = copytree(ROOT, Path(scratch) / "tree", symlinks=True, ignore=ignore_patterns(*NOT_SOURCE))
        for product in PRODUCTS:
            with chdir(tree / product):
                source = folder / build_meta.build_sdist(str(folder))
            with tarfile.open(source) as archive:
                archive.extractall(scratch, filter="data")
            with chdir(Path(scratch) / source.name.removesuffix(".tar.gz")):
                build_meta.build_wheel(str(folder))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

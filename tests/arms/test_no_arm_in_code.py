"""Code names no arm: what tells one from another stands in its `arm.toml`."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.arm_model.load import arm_names

ROOT = Path(__file__).parents[2]
FILES = sorted(path for package in ("fsw", "sim", "marsarm") for path in (ROOT / package).rglob("*.py"))
ARM = re.compile("|".join([*arm_names(), "curiosity", "perseverance"]), re.IGNORECASE)


def words_of(tree: ast.AST) -> Iterator[str]:
    """Yield names, and texts without a space: those with one are for readers."""
    for node in ast.walk(tree):
        for field in ("id", "attr", "arg", "name", "value"):
            word = getattr(node, field, None)
            if isinstance(word, str) and " " not in word:
                yield word


@pytest.mark.parametrize("package", ["fsw", "sim", "marsarm"])
def test_no_name_and_no_key_is_that_of_an_arm(package):
    files = [path for path in FILES if path.relative_to(ROOT).parts[0] == package]
    assert files
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in files}
    assert {path: word for path, tree in trees.items() for word in words_of(tree) if ARM.search(word)} == {}


def test_a_name_would_be_found():
    assert any(ARM.search(word) for word in words_of(ast.parse("x = arms['msl']")))

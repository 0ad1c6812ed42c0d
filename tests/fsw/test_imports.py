"""Flight software is pure: numpy, ruckig, itself and a few words of the language, no file and no print."""

import ast
from pathlib import Path

import pytest

import fsw

ROOT = Path(fsw.__file__).parent
ALLOWED = {
    *("abc", "collections.abc", "dataclasses", "enum", "fsw", "functools", "hashlib", "itertools"),
    *("math", "numpy", "operator", "ruckig", "types", "typing"),
}
FORBIDDEN_CALLS = {"open", "print", "input", "exec", "eval", "compile", "__import__", "globals", "breakpoint"}
FORBIDDEN_NAMES = {"random", "load", "save", "fromfile", "tofile", "genfromtxt", "loadtxt", "memmap"}


def imported(node):
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        yield "." * node.level + (node.module or "")


@pytest.fixture(scope="module")
def nodes():
    """All nodes of the syntax trees of flight software, each with its file."""
    files = [(str(path.relative_to(ROOT)), path.read_text()) for path in sorted(ROOT.rglob("*.py"))]
    assert files
    return [(file, node) for file, text in files for node in ast.walk(ast.parse(text))]


def test_only_allowed_modules_are_imported(nodes):
    found = [(file, one) for file, node in nodes for one in imported(node) if one not in ALLOWED]
    assert [one for one in found if one[1].split(".")[0] not in {"fsw", "numpy", "ruckig"}] == []


def test_nothing_is_opened_printed_or_evaluated(nodes):
    calls = [(file, getattr(node.func, "id", "")) for file, node in nodes if isinstance(node, ast.Call)]
    assert [(file, name) for file, name in calls if name in FORBIDDEN_CALLS] == []


def test_numpy_is_used_for_numbers_only(nodes):
    read = [(file, node) for file, node in nodes if isinstance(node, ast.Attribute)]
    of_numpy = [(file, node.attr) for file, node in read if getattr(node.value, "id", "") == "np"]
    assert of_numpy
    assert [(file, name) for file, name in of_numpy if name in FORBIDDEN_NAMES] == []


def test_no_name_is_global_or_nonlocal(nodes):
    assert [file for file, node in nodes if isinstance(node, ast.Global | ast.Nonlocal)] == []


def test_no_exception_is_caught(nodes):
    assert [file for file, node in nodes if isinstance(node, ast.Try | ast.TryStar)] == []


def test_nothing_knows_of_simulation_or_replay(nodes):
    names = [(file, node.id) for file, node in nodes if isinstance(node, ast.Name)]
    names += [(file, node.arg) for file, node in nodes if isinstance(node, ast.arg)]
    assert [one for one in names if one[1].startswith(("sim_", "is_sim", "replay", "simul"))] == []


def test_every_record_is_frozen_and_slotted(nodes):
    for file, node in nodes:
        for mark in getattr(node, "decorator_list", []):
            if isinstance(mark, ast.Call) and getattr(mark.func, "id", "") == "dataclass":
                words = {k.arg: getattr(k.value, "value", None) for k in mark.keywords}
                assert words.get("frozen") is True, (file, node.name)
                assert words.get("slots") is True or _computes_when_read(node), (file, node.name)


def _computes_when_read(node):
    """Return whether a record keeps a value that it computes when it is read; slots have no room for it."""
    marks = [mark for part in node.body for mark in getattr(part, "decorator_list", [])]
    return any(getattr(mark, "id", "") == "cached_property" for mark in marks)

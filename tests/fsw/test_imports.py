"""Flight software is pure: numpy, ruckig, itself and a few words of the language, no file and no print."""

import ast
from pathlib import Path

import pytest

import fsw

ROOT = Path(fsw.__file__).parent
FILES = sorted(ROOT.rglob("*.py"))
ALLOWED = {
    "collections.abc",
    "dataclasses",
    "enum",
    "fsw",
    "functools",
    "hashlib",
    "itertools",
    "math",
    "numpy",
    "operator",
    "ruckig",
    "types",
    "typing",
}
FORBIDDEN_CALLS = {"open", "print", "input", "exec", "eval", "compile", "__import__", "globals", "breakpoint"}
FORBIDDEN_NAMES = {"random", "load", "save", "fromfile", "tofile", "genfromtxt", "loadtxt", "memmap"}


def imported(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")


def allowed(module):
    return module in ALLOWED or module.split(".")[0] in {"fsw", "numpy", "ruckig"}


@pytest.fixture(scope="module", params=FILES, ids=lambda path: str(path.relative_to(ROOT)))
def tree(request):
    return ast.parse(request.param.read_text())


def test_only_allowed_modules_are_imported(tree):
    assert [module for module in imported(tree) if not allowed(module)] == []


def test_nothing_is_opened_printed_or_evaluated(tree):
    calls = {n.func.id for n in ast.walk(tree) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
    assert calls & FORBIDDEN_CALLS == set()


def test_numpy_is_used_for_numbers_only(tree):
    attributes = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "np"
    }
    assert attributes & FORBIDDEN_NAMES == set()


def test_no_name_is_global_or_nonlocal(tree):
    assert not any(isinstance(node, ast.Global | ast.Nonlocal) for node in ast.walk(tree))


def test_no_exception_is_caught(tree):
    assert not any(isinstance(node, ast.Try) for node in ast.walk(tree))


def test_nothing_knows_of_simulation_or_replay(tree):
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    names |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    assert [n for n in names if n.startswith(("sim_", "is_sim", "replay", "simul"))] == []


def test_every_record_is_frozen_and_slotted(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            for mark in node.decorator_list:
                if isinstance(mark, ast.Call) and getattr(mark.func, "id", "") == "dataclass":
                    words = {k.arg: getattr(k.value, "value", None) for k in mark.keywords}
                    assert words.get("frozen") is True, node.name
                    assert words.get("slots") is True or _computes_when_read(node), node.name


def _computes_when_read(node):
    """Return whether a record keeps a value that it computes when it is read; slots have no room for it."""
    marks = [mark for part in node.body for mark in getattr(part, "decorator_list", [])]
    return any(getattr(mark, "id", "") == "cached_property" for mark in marks)

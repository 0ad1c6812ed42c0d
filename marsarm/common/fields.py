"""Units of fields by their names, and docstrings of fields, which Python does not keep, from the source."""

import ast
import inspect
import sys
import textwrap
from functools import cache
from itertools import pairwise
from typing import Any, Final

UNIT_SYMBOLS: Final = {
    "rad": "rad",
    "urad": "urad",
    "m": "m",
    "s": "s",
    "A": "A",
    "N": "N",
    "Nm": "N m",
    "C": "degC",
    "K": "K",
    "J": "J",
    "kg": "kg",
    "Hz": "Hz",
    "Pa": "Pa",
    "V": "V",
    "W": "W",
    "count": "count",
    "1": "1",
    "s2": "s2",
    "s3": "s3",
}
"""Unit for each part of a suffix."""

DIMENSIONLESS: Final = {
    "tick": "cycle",
    "cycle": "cycle",
    "cycles": "cycle",
    "persistence": "cycle",
    "period": "cycle",
    "turn": "count",
    "share": "1",
    "fraction": "1",
    "ratio": "1",
    "factor": "1",
    "side": "1",
    "along": "1",
    "across": "1",
}
"""Unit for the last word of a name without a unit suffix: the counted thing, or 1 for a pure number."""

UNIT_VECTORS: Final = ("approach", "gravity", "normal", "R")
"""First words of names of directions and rotations, whose components are pure numbers."""

UNITS_BY_NAME: Final = {"compliance": "mixed", "value": "of the parameter", "bound": "cycle"}
"""Unit of names for which the docstring, or another field, gives the unit."""


def unit_of(name: str) -> str | None:
    """Derive the unit of a field from its name: "1" for a pure number, None if the name has no unit."""
    words = name.split("_")
    suffix: list[str] = []
    while words and words[-1] in UNIT_SYMBOLS and len(suffix) < 2:
        suffix.insert(0, UNIT_SYMBOLS[words.pop()])
    if suffix:
        top, *below = suffix
        return top if not below else f"{top}/{below[0] if ' ' not in below[0] else f'({below[0]})'}"
    if words[-1] in DIMENSIONLESS:
        return DIMENSIONLESS[words[-1]]
    return "1" if words[0] in UNIT_VECTORS else UNITS_BY_NAME.get(name)


@cache
def field_docs(kind: type) -> dict[str, str]:
    """Read the docstrings of the fields of a dataclass, by name; fields without one are left out."""
    node = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    return _attribute_docs(node.body) if isinstance(node, ast.ClassDef) else {}


@cache
def alias_docs(module: str) -> dict[str, str]:
    """Read the docstrings of the names that a module assigns, such as `BacklashMode`."""
    return _attribute_docs(ast.parse(inspect.getsource(sys.modules[module])).body)


def class_doc(kind: type) -> str:
    """Return the docstring of a class with the lines of each paragraph joined."""
    return _unwrap(inspect.getdoc(kind) or "")


def _attribute_docs(body: list[ast.stmt]) -> dict[str, str]:
    """Collect the strings that directly follow an assignment, by the assigned name."""
    return {
        _target(node): _unwrap(inspect.cleandoc(below.value.value))
        for node, below in pairwise(body)
        if isinstance(node, ast.AnnAssign | ast.Assign)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
        and isinstance(below.value.value, str)
    }


def _target(node: Any) -> str:
    return str(ast.unparse(node.target if isinstance(node, ast.AnnAssign) else node.targets[0]))


def _unwrap(text: str) -> str:
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))

"""The words beside a field in the source: a string below it, which Python itself forgets."""

import ast
import inspect
import sys
import textwrap
from functools import cache
from itertools import pairwise
from typing import Any


@cache
def field_texts(kind: type) -> dict[str, str]:
    """What the source says of each field of a dataclass, by name; a field without words is not there."""
    found = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    return _below(found.body) if isinstance(found, ast.ClassDef) else {}


@cache
def alias_texts(module: str) -> dict[str, str]:
    """What a module says of each of its own names, such as `Backlash`."""
    return _below(ast.parse(inspect.getsource(sys.modules[module])).body)


def class_text(kind: type) -> str:
    """The docstring of a class, lines joined, paragraphs kept."""
    return _flowing(inspect.getdoc(kind) or "")


def _below(body: list[ast.stmt]) -> dict[str, str]:
    """The strings that stand right below an assignment."""
    return {
        _target(node): _flowing(inspect.cleandoc(below.value.value))
        for node, below in pairwise(body)
        if isinstance(node, ast.AnnAssign | ast.Assign)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
        and isinstance(below.value.value, str)
    }


def _target(node: Any) -> str:
    return str(ast.unparse(node.target if isinstance(node, ast.AnnAssign) else node.targets[0]))


def _flowing(text: str) -> str:
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))

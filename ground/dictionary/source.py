"""The words beside a field in the source: a string below it, which Python itself forgets."""

import ast
import inspect
import sys
from functools import cache
from itertools import pairwise
from typing import Any


@cache
def field_texts(kind: type) -> dict[str, str]:
    """What the source says of each field of a dataclass, by name; a field without words is not there."""
    return _texts(_tree(kind.__module__), kind.__name__)


@cache
def alias_texts(module: str) -> dict[str, str]:
    """What a module says of each of its own names, such as `Backlash`."""
    return _below(_tree(module).body)


def class_text(kind: type) -> str:
    """The docstring of a class, lines joined, paragraphs kept."""
    return _flowing(inspect.getdoc(kind) or "")


@cache
def _tree(module: str) -> ast.Module:
    return ast.parse(inspect.getsource(sys.modules[module]))


def _texts(tree: ast.Module, name: str) -> dict[str, str]:
    classes = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name)
    return _below(next(classes).body)


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

"""What a schema says about a field for people: its unit, its limits and its docstring."""

import ast
import inspect
import textwrap
from functools import cache
from typing import Any, Final, get_args

from fsw.dictionary.params import Limits

UNITS: Final = {
    "m": "m",
    "m_s": "m/s",
    "m_s2": "m/s^2",
    "rad": "rad",
    "rad_s": "rad/s",
    "rad_s2": "rad/s^2",
    "s": "s",
    "A": "A",
    "C": "degC",
    "N": "N",
    "Nm": "N m",
    "J": "J",
    "count": "counts",
}
"""The unit by the suffix of a field's name; the longest that fits."""


def unit_of(name: str) -> str | None:
    """The unit that the suffix of a name says; None for a number or a name without one."""
    words = name.split("_")
    tails = ("_".join(words[k:]) for k in range(1, len(words)))
    return next((UNITS[tail] for tail in tails if tail in UNITS), None)


def limits_of(hint: Any) -> Limits | None:
    """The limits of an annotation; None if it has none."""
    return next((one for one in get_args(hint)[1:] if isinstance(one, Limits)), None)


@cache
def docs_of(owner: type) -> dict[str, str]:
    """The docstrings of a dataclass's fields, each as one line."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(owner))).body[0]
    assert isinstance(tree, ast.ClassDef)
    found = {}
    for field, after in zip(tree.body, tree.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            match after:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    found[field.target.id] = " ".join(text.split())
    return found

"""Find why a robot and its MuJoCo model differ: where, by which effect, and how far.

`__init__.pyi` lists the public names with their types; each is imported when it is first used.
"""

import ast
from importlib import import_module
from importlib.resources import files
from typing import Any, Final

_STUB: Final = ast.parse(files(__name__).joinpath("__init__.pyi").read_text(encoding="utf-8"))
_HOME: Final = {
    alias.name: node.module or ""
    for node in _STUB.body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
"""Module of each public name."""
__all__ = tuple(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})

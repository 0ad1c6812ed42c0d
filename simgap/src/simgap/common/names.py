"""Public names of a package: its `__init__.pyi` lists them, and each is imported when it is first used."""

import sys
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


@cache
def list_names(package: str) -> dict[str, str]:
    """Return the module of each name that the `__init__.pyi` of a package lists."""
    import ast  # commands ask for no name

    path = Path(sys.modules[package].__path__[0], "__init__.pyi")
    body = ast.parse(path.read_text(encoding="utf-8")).body
    imports = [node for node in body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


def load_name(package: str, name: str) -> Any:
    """Import a name, and keep it in the package; `__all__` is all names; AttributeError if it is unknown."""
    if name == "__all__":
        return tuple(list_names(package))
    if name.startswith("_") or name not in list_names(package):
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    value = getattr(import_module(list_names(package)[name]), name)
    setattr(sys.modules[package], name, value)
    return value

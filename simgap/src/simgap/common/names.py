"""Public names of a package: its `__init__.pyi` lists them, and each is imported when it is first used."""

import ast
import sys
from collections.abc import Mapping
from importlib import import_module
from importlib.resources import files
from typing import Any


def list_names(package: str) -> dict[str, str]:
    """Return the module of each name that the `__init__.pyi` of a package lists."""
    stub = ast.parse(files(package).joinpath("__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: node.module or "" for node in imports for alias in node.names}


def load_name(package: str, home: Mapping[str, str], name: str) -> Any:
    """Import a name from its module, and keep it in the package.

    Raises:
        AttributeError: The package has no such name.
    """
    if name not in home:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    value = getattr(import_module(home[name]), name)
    setattr(sys.modules[package], name, value)
    return value

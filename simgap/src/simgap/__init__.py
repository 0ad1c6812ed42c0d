"""Find why a robot and its MuJoCo model differ: where, by which effect, and how far.

`__init__.pyi` lists the public names with their types; each is imported when it is first used.
"""

from typing import Any, Final

from simgap.common.names import list_names, load_name

_HOME: Final = list_names(__name__)
"""Module of each public name."""
__all__ = tuple(_HOME)


def __getattr__(name: str) -> Any:
    return load_name(__name__, _HOME, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})

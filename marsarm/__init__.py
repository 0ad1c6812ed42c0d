"""Names for Python users: closed loop, effects, logs, and the verbs of the command line.

`__init__.pyi` lists them with their types; each is imported when it is first used. docs/python.md shows how.
"""

from typing import Any

from simgap.common.names import list_names, load_name


def __getattr__(name: str) -> Any:
    return load_name(__name__, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *list_names(__name__)})

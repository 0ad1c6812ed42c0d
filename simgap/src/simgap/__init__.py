"""Find why a robot and its MuJoCo model differ: where, by which effect, and how far.

`__init__.pyi` lists the public names with their types; each is imported when it is first used.
"""

from typing import Any

from simgap.common.names import list_names, load_name


def __getattr__(name: str) -> Any:
    return load_name(__name__, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *list_names(__name__)})

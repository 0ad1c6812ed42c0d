"""Command line that a request stands for, so that a report says how to compute it again.

Files that are written are left out: the name of a report is not part of its content.
"""

import shlex
from collections.abc import Iterator
from dataclasses import MISSING
from typing import Any

from simgap.common.options import Field, option_fields


def command_text(verb: str, request: Any) -> str:
    """Return the command line of a request, without options that have their defaults."""
    return shlex.join(["marsarm", *verb.split(), *_words(request, MISSING)])


def _words(request: Any, group: Any) -> Iterator[str]:
    """Yield the words of a request; `group` holds its defaults if it is a group in another request."""
    for field in option_fields(type(request)):
        value = getattr(request, field.name)
        default = field.default if group is MISSING else getattr(group, field.name)
        if field.option is None:
            yield from _words(value, default)
        elif value != default and not field.option.suffixes:
            yield from _option_words(field, value)


def _option_words(field: Field, value: Any) -> Iterator[str]:
    assert field.option is not None
    values = value if isinstance(value, tuple) else (value,)
    name = f"--{field.label}"
    if field.option.is_argument:
        yield from map(str, values)
    elif value is None:
        yield f"--no-{field.label}"
    elif value is True:
        yield name
    elif _is_repeatable(field):
        for one in values:
            yield from (name, str(one))
    else:
        yield from (name, *map(str, values))


def _is_repeatable(field: Field) -> bool:
    """Check whether an option is given once for each value: its type is a tuple of any length."""
    return getattr(field.type, "__args__", ())[1:] == (...,)

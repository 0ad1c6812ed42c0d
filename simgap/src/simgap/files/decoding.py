"""Decoding of messages: JSON, and those of ROS 1 and ROS 2 by their definitions."""

import json
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Decoder = Callable[[bytes], Any]
DEFINITIONS: Final = {"ros1": ("ros1msg",), "cdr": ("ros2msg", "ros2idl")}
"""Encodings of messages of ROS -> encodings of their definitions."""
IDL_RULE: Final = "=" * 80 + "\nIDL: "
"""Before each definition, in a text with several."""


class BadMessage(Exception):
    """A definition or a message cannot be read."""


@lru_cache(maxsize=64)  # Rosbags writes and compiles a program for each definition.
def make_decoder(encoding: str, schema_encoding: str, name: str, definition: bytes) -> Decoder | None:
    """Return the decoder of messages in json, ros1 or cdr, else None; BadMessage for a bad definition."""
    if encoding == "json":
        return _decode_json
    if schema_encoding not in DEFINITIONS.get(encoding, ()):
        return None
    try:
        text = definition.decode()
        store = parse_definition(text, name, is_idl=schema_encoding == "ros2idl")
    except (UnicodeDecodeError, TypesysError, SerdeError, ValueError, LookupError, AttributeError) as error:
        raise BadMessage(f"the definition of {name} cannot be read") from error
    return ros_decoder(store, name, is_ros1=encoding == "ros1")


def parse_definition(text: str, name: str, is_idl: bool = False) -> Typestore:
    """Parse the definition of a type and of those in it."""
    store = get_typestore(Stores.EMPTY)
    if is_idl:
        rule, _, head = IDL_RULE.rpartition("\n")
        parts = text.split(f"{rule}\n")[1:] if text.startswith(IDL_RULE) else [f"{head}\n{text}"]
        for part in parts:
            store.register(get_types_from_idl(part.partition("\n")[2]))
    else:
        store.register(get_types_from_msg(text, _long(name)))
    return store


def ros_decoder(store: Typestore, name: str, is_ros1: bool) -> Decoder:
    """Return the decoder of messages of ROS."""
    kind = _long(name)

    def decode(data: bytes) -> Any:
        try:
            return store.deserialize_ros1(data, kind) if is_ros1 else store.deserialize_cdr(data, kind)
        except (SerdeError, LookupError, ValueError, TypeError, AssertionError) as error:
            raise BadMessage(f"a message of {name} does not fit its definition") from error

    return decode


def _decode_json(data: bytes) -> Any:
    try:
        return json.loads(data)
    except ValueError as error:
        raise BadMessage(f"a message is no JSON: {error}") from error


def _long(name: str) -> str:
    """Return a type with the folder in its middle: a/B is a/msg/B."""
    package, _, kind = name.strip().partition("/")
    return f"{package}/msg/{kind}" if kind and "/" not in kind else name.strip()

"""TOML with the line of every value, which Python's parser does not return."""

import re
import tomllib
from typing import Any, Final

from sim.text_file import load_toml

TomlPath = tuple[str | int, ...]
"""Keys and indices that lead to a value."""

_BLANK: Final = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACES: Final = re.compile(r"[ \t]*")
_KEY: Final = re.compile(r"""[A-Za-z0-9_-]+|"(?:\\.|[^"\\\n])*"|'[^'\n]*'""")
_STRING: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}(?!")|' + r"'''.*?'{3,5}(?!')|" + r""""(?:\\.|[^"\\\n])*"|'[^'\n]*'""",
    re.DOTALL,
)
_OTHER: Final = re.compile(r"[^,\]\}\n#]*")


class NotToml(ValueError):
    """Text that is no TOML, and its line, from 1."""

    def __init__(self, line: int, why: str):
        super().__init__(f"is not TOML: {why}")
        self.line = line


def parse_toml(text: str) -> tuple[dict[str, Any], dict[TomlPath, int]]:
    """Parse a text, and find the line of every key, table and element.

    Raises:
        NotToml: Python's parser refuses the text.
    """
    try:
        return load_toml(text), find_lines(text)
    except tomllib.TOMLDecodeError as error:
        match = re.fullmatch(r"(.*) \(at (?:line (\d+), column \d+|end of document)\)", str(error), re.DOTALL)
        if match is None:
            raise NotToml(1, str(error)) from error
        raise NotToml(int(match[2]) if match[2] else text.count("\n") + 1, match[1]) from error
    except ValueError as error:
        raise NotToml(1, str(error)) from error


def find_lines(text: str) -> dict[TomlPath, int]:
    """Find the line, from 1, of every key, table and element of a text that the parser accepted."""
    return _Finder(text).places


class _Finder:
    """Reader that passes a text once and records where values begin."""

    def __init__(self, text: str):
        self.places: dict[TomlPath, int] = {(): 1}
        self._text = text.replace("\r\n", "\n")
        self._at = 0
        self._counts: dict[TomlPath, int] = {}
        self._file()

    def _file(self) -> None:
        table: TomlPath = ()
        self._skip(_BLANK)
        while self._at < len(self._text):
            if self._next("[["):
                table = self._header("[[")
            elif self._next("["):
                table = self._header("[")
            else:
                self._pair(table)
            self._skip(_BLANK)

    def _header(self, opening: str) -> TomlPath:
        """Read a header; one of a list counts its tables, and a name below it means the last table."""
        begun = self._at
        self._at += len(opening)
        names = self._names()
        self._at += len(opening)
        place: TomlPath = ()
        for k, name in enumerate(names):
            place = (*place, name)
            self._note(place, begun)
            if opening == "[[" and k == len(names) - 1:
                self._counts[place] = self._counts.get(place, 0) + 1
            if place in self._counts:
                place = (*place, self._counts[place] - 1)
                self._note(place, begun)
        return place

    def _pair(self, table: TomlPath) -> None:
        begun = self._at
        place = (*table, *self._names())
        for k in range(len(table) + 1, len(place) + 1):
            self._note(place[:k], begun)
        self._at += 1  # the equals sign
        self._skip(_SPACES)
        self._value(place)

    def _names(self) -> list[str]:
        """Read a key, dotted or not, and the spaces around it."""
        names = []
        while True:
            self._skip(_SPACES)
            key = self._skip(_KEY)
            names.append(tomllib.loads(f"key = {key}")["key"] if key[0] in "\"'" else key)
            self._skip(_SPACES)
            if not self._next("."):
                return names
            self._at += 1

    def _value(self, place: TomlPath) -> None:
        if self._next("["):
            self._array(place)
        elif self._next("{"):
            self._inline(place)
        elif self._next('"') or self._next("'"):
            self._skip(_STRING)
        else:
            self._skip(_OTHER)

    def _array(self, place: TomlPath) -> None:
        self._at += 1
        count = 0
        self._skip(_BLANK)
        while not self._next("]"):
            self._note((*place, count), self._at)
            self._value((*place, count))
            count += 1
            self._comma()
        self._at += 1

    def _inline(self, place: TomlPath) -> None:
        self._at += 1
        self._skip(_BLANK)
        while not self._next("}"):
            self._pair(place)
            self._comma()
        self._at += 1

    def _comma(self) -> None:
        self._skip(_BLANK)
        if self._next(","):
            self._at += 1
            self._skip(_BLANK)

    def _next(self, what: str) -> bool:
        return self._text.startswith(what, self._at)

    def _skip(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self._text, self._at)
        if match is None:
            raise ValueError(f"not TOML at {self._text[self._at : self._at + 20]!r}; parse the text first")
        self._at = match.end()
        return match[0]

    def _note(self, place: TomlPath, at: int) -> None:
        self.places.setdefault(place, self._text.count("\n", 0, at) + 1)

"""Draft of a robot file, and its text with reasons and questions as comments."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from textwrap import wrap
from typing import Any, Final

import tomlkit

WIDTH: Final = 100


@dataclass(slots=True)
class Draft:
    """Content of a robot file, and what is said of its keys."""

    content: dict[str, Any] = field(default_factory=dict)
    reasons: dict[tuple[str, ...], str] = field(default_factory=dict)
    questions: dict[tuple[str, ...], list[str]] = field(default_factory=dict)

    def ask(self, question: str, *key: str) -> None:
        """Ask a question at a key, once."""
        own = self.questions.setdefault(key, [])
        if question and question not in own:
            own.append(question)

    def joint(self, name: str) -> dict[str, Any]:
        """Return the table of a joint."""
        return self.content["joints"][name]  # type: ignore[no-any-return]


def list_questions(draft: Draft) -> list[str]:
    """Return the questions with their places; one that is the same at several places once."""
    places: dict[str, list[str]] = {}
    for key, own in draft.questions.items():
        for one in own:
            places.setdefault(one, []).append(".".join(key))
    return [f"{', '.join(where)}: {one}" for one, where in places.items()]


def robot_file_lines(draft: Draft, source: str) -> Iterator[str]:
    """Yield the lines of the file of a draft; the first names what it was written from."""
    yield from _comment(f"Written from {source}.")
    yield '# A comment gives the reason of the line below it. A line with "Question:" waits for your answer.'
    tables = {key: value for key, value in draft.content.items() if isinstance(value, dict)}
    for key, value in draft.content.items():
        if key not in tables:
            yield from _entry(draft, (key,), value)
    for key in ("time", "motion"):
        if key in tables:
            yield ""
            yield from _comments(draft, (key,))
            yield f"[{key}]"
            for name, value in tables[key].items():
                yield f"{name} = {_value(value)}"
    if ("joints",) in draft.questions or ("joints",) in draft.reasons:
        yield ""
        yield from _comments(draft, ("joints",))
    for joint, table in tables["joints"].items():
        yield ""
        yield from _comments(draft, ("joints", joint))
        yield f"[joints.{tomlkit.key(joint).as_string()}]"
        for key, value in table.items():
            yield from _entry(draft, ("joints", joint, key), value)


def _entry(draft: Draft, key: tuple[str, ...], value: Any) -> Iterator[str]:
    yield from _comments(draft, key)
    yield f"{key[-1]} = {_value(value)}"


def _comments(draft: Draft, key: tuple[str, ...]) -> Iterator[str]:
    reason = draft.reasons.get(key, "")
    if reason:
        yield from _comment(reason[0].upper() + reason[1:] + ".")
    for question in draft.questions.get(key, ()):
        yield from _comment(f"Question: {question}")


def _comment(text: str) -> Iterator[str]:
    yield from wrap(text, WIDTH, initial_indent="# ", subsequent_indent="#   ", break_long_words=False)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(one)}" for key, one in value.items()) + " }"
    return str(tomlkit.item(value).as_string())

"""Report pages: one self-contained HTML file each, with the verdict first, then the origin of the result.

A page fits screens from 320 pixels on, and follows the light or dark scheme of the reader. The same result
gives the same bytes, except for the date.
"""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from simgap.common.console import NUMBER
from simgap.common.files import atomic_write
from simgap.common.origin import current_date, git_revision


@dataclass(frozen=True, slots=True)
class Requirement:
    """Requirement with the value that a result has for it."""

    text: str
    bound: str
    value: str
    passed: bool | None
    """None if the result does not decide it."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a result."""

    command: str
    """Command that computes it again; its first word is the package whose version is shown."""
    digests: Mapping[str, str]
    """SHA-256 by name of what was digested."""


def save_page(
    title: str,
    verdict: str | Mapping[str, str],
    requirements: Sequence[Requirement],
    origin: Origin | None,
    parts: Sequence[str],
    path: Path,
) -> None:
    """Write a page.

    Args:
        verdict: Sentence about the result, or sentences by what they say; empty for a count of the
            requirements that are met.
        origin: Origin of the result; None for a page without it, the same at any time.
        parts: Further parts in HTML, as the other functions here make them.

    Raises:
        BadOutput: the file cannot be written.
        BadRequest: the date in the environment is wrong.
    """
    style = resources.files("simgap.common").joinpath("page.css").read_text(encoding="utf-8")
    lines = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{html.escape(title)}</title><style>\n{style}</style></head><body><main>",
        f"<h1>{html.escape(title)}</h1>",
        _verdict(verdict or count_met(requirements), _kind(requirements)),
        *([_requirement_table(requirements)] if requirements else []),
        *([_origin_list(origin)] if origin is not None else []),
        *parts,
        "</main></body></html>\n",
    ]
    with atomic_write(path, "report") as file:
        file.write("\n".join(lines).encode())


def count_met(requirements: Sequence[Requirement]) -> str:
    """Make a sentence of the number of requirements that are met."""
    decided = [one for one in requirements if one.passed is not None]
    met = sum(one.passed is True for one in decided)
    count, failed, undecided = len(requirements), len(decided) - met, len(requirements) - len(decided)
    rest = f", {undecided} {'is' if undecided == 1 else 'are'} not shown" if undecided else ""
    if failed:
        return f"Fail: {failed} of {count} requirements are not met{rest}."
    return f"{'Not shown' if undecided else 'Pass'}: {met} of {count} requirements are met{rest}."


def _kind(requirements: Sequence[Requirement]) -> str:
    """Return the class in the style sheet of the worst verdict; empty without requirements."""
    verdicts = [one.passed for one in requirements]
    worst = "fail" if False in verdicts else "open" if None in verdicts else "pass"
    return worst if verdicts else ""


def _verdict(verdict: str | Mapping[str, str], kind: str) -> str:
    """Return the element of a verdict: a paragraph, or a list of sentences."""
    if isinstance(verdict, str):
        return f'<p class="verdict {kind}">{html.escape(verdict)}</p>'
    return f'<dl class="verdict">{_items(verdict, "{}")}</dl>'


def _items(items: Mapping[str, str], form: str) -> str:
    """Return the items of a list of definitions, their texts in a form."""
    shown = ((html.escape(name), html.escape(text)) for name, text in items.items())
    return "".join(f"<dt>{name}</dt><dd>{form.format(text)}</dd>" for name, text in shown)


def _requirement_table(requirements: Sequence[Requirement]) -> str:
    words = {True: ("pass", "pass"), False: ("fail", "FAIL"), None: ("open", "not shown")}
    head = ("requirement", "bound", "value", "verdict")
    rows = [(one.text, one.bound, one.value, words[one.passed][1]) for one in requirements]
    return table(head, rows, [words[one.passed][0] for one in requirements])


def _origin_list(origin: Origin) -> str:
    from importlib.metadata import version  # few commands write a page

    program = origin.command.partition(" ")[0]
    items = {
        "version": f"{program} {version(program)}, commit {git_revision()}",
        "command": origin.command,
        "date": current_date().strftime("%Y-%m-%d %H:%M:%S UTC"),
        **{f"SHA-256, {name}": digest for name, digest in origin.digests.items()},
    }
    listed = _items(items, "<code>{}</code>")
    return f'<details><summary>Command, version and files</summary><dl class="origin">{listed}</dl></details>'


def paragraph(text: str) -> str:
    """Make a paragraph of plain text."""
    return f"<p>{html.escape(text)}</p>"


def heading(text: str) -> str:
    """Make a heading below the title."""
    return f"<h2>{html.escape(text)}</h2>"


def figures(*svgs: str) -> str:
    """Put figures of `render_svg` side by side where there is room for several."""
    return "\n".join(['<div class="figures">', *(f"<figure>{svg}</figure>" for svg in svgs), "</div>"])


def table(head: Sequence[str], rows: Sequence[Sequence[str]], last: Sequence[str] = ()) -> str:
    """Make a table that scrolls if it is too wide; `last` has a class for the last cell of each row."""
    is_number = [all(NUMBER.fullmatch(cell) for cell in column if cell) for column in zip(*rows, strict=True)]
    kinds = ["number" if k > 0 and numeric else "" for k, numeric in enumerate(is_number)]
    kinds += [""] * (len(head) - len(kinds))
    heads = "".join(_cell("th", name, kind) for name, kind in zip(head, kinds, strict=True))
    lines = []
    for k, row in enumerate(rows):
        own = [*kinds[:-1], last[k]] if last else kinds
        lines.append("".join(_cell("td", text, kind) for text, kind in zip(row, own, strict=True)))
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    whole = f"<table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="scroll" tabindex="0">{whole}</div>'


def _cell(tag: str, text: str, kind: str) -> str:
    label = f' class="{kind}"' if kind else ""
    breakable = html.escape(text).replace("_", "_<wbr>")
    return f"<{tag}{label}>{breakable}</{tag}>"

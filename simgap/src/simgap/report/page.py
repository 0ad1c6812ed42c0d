"""Page of a diagnosis without the project's command line: one file that asks for nothing else."""

import html
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from simgap.report.parts import page_parts
from simgap.report.sentences import verdict_lines, verdict_word
from simgap.report.traces import Trace
from simgap.result import Diagnosis


def page_title(diagnosis: Diagnosis) -> str:
    """Return the title of the page of a diagnosis."""
    titles = {
        "named": "The error has a name",
        "set": "The error has one of several names",
        "none": "No effect is seen",
        "unknown": "The error is not in the catalogue",
    }
    return f"{diagnosis.robot}: {titles[verdict_word(diagnosis)]}"


def save_page(diagnosis: Diagnosis, traces: Sequence[Trace], path: Path) -> None:
    """Write the page; the same diagnosis gives the same bytes.

    Args:
        traces: Traces of held-out motions.
        path: The HTML file.
    """
    style = files("simgap.report").joinpath("page.css").read_text(encoding="utf-8")
    title = html.escape(page_title(diagnosis))
    lines = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{title}</title><style>\n{style}</style></head><body><main><h1>{title}</h1>",
        f'<p class="verdict">{html.escape(chr(10).join(verdict_lines(diagnosis)))}</p>',
        *page_parts(diagnosis, traces),
        "</main></body></html>\n",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")

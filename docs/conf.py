"""Settings of the site of documents and Python reference, which `make site` builds with Sphinx."""

import re
from pathlib import Path
from typing import Any, Final

from sphinx.application import Sphinx

ROOT: Final = Path(__file__).resolve().parents[1]
CONTENTS: Final = {
    "First steps": ("simgap/README", "docs/notebooks/arm", "docs/notebooks/gap"),
    "The arm on Mars": (
        *("docs/commands", "docs/run", "docs/arms", "docs/logs", "docs/effects"),
        *("docs/accuracy", "docs/calibration", "docs/diagnosis"),
    ),
    "Any robot": ("docs/simgap", "docs/robot-file", "docs/robot-effects", "docs/method", "docs/peers"),
    "Python": ("docs/python", "docs/reference/marsarm", "docs/reference/simgap"),
    "Evidence": ("docs/results", "docs/requirements"),
    "Inside": (
        *("docs/architecture", "docs/flight-software", "docs/faults", "docs/frames", "docs/glossary"),
        *sorted(f"docs/decisions/{one.stem}" for one in (ROOT / "docs/decisions").glob("*.md")),
        *sorted(
            str(one.relative_to(ROOT).with_suffix("")) for one in (ROOT / "models").glob("**/PROVENANCE.md")
        ),
        *("CONTRIBUTING", "CHANGELOG"),
    ),
}
"""Sections of the list at the side, with their pages."""

project = "marsarm and simgap"
copyright = "marsarm contributors"
root_doc = "README"
include_patterns = [f"{page}.*" for section in CONTENTS.values() for page in section]
include_patterns += ["README.md"]
exclude_patterns = ["**/*.png", "**/*.py"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
suppress_warnings = ["ref.python"]  # names of fields are not unique
FOLDER: Final = re.compile(r"\[([^\]]+)\]\([^)\s]+/\)")
"""Link to a folder, which has no page."""
nb_execution_mode = "off"  # a test runs the notebooks
myst_heading_anchors = 4
default_role = "code"
autodoc_member_order = "groupwise"
autodoc_default_options = {"members": True, "undoc-members": True, "imported-members": True}
autodoc_typehints_format = "short"
html_theme = "furo"
html_title = project
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # it would need a server


def change_source(_: Sphinx, page: str, text: list[str]) -> None:
    """Take out links to folders; give the README, which is the first page, the list of all pages."""
    text[0] = FOLDER.sub(r"\1", text[0])
    if page == root_doc:
        for section, pages in CONTENTS.items():
            lines = "\n".join(f"/{one}" for one in pages)
            text[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {section}\n\n{lines}\n```\n"


def write_first_page(app: Sphinx, error: Exception | None) -> None:
    """Lead from the folder to the README."""
    if error is None:
        first = '<meta http-equiv="refresh" content="0; url=README.html"><title>marsarm and simgap</title>\n'
        (Path(app.outdir) / "index.html").write_text(f"<!doctype html>{first}")


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the two to the build."""
    app.connect("source-read", change_source)
    app.connect("build-finished", write_first_page)
    return {"parallel_read_safe": True}

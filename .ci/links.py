"""Check the links of the documents and notebooks, of which the site is made.

`python .ci/links.py` prints each link to a file or heading that does not exist, and each file of docs/ that
cannot be reached from the README, and fails if there is any.
"""

import json
import re
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
CODE: Final = re.compile(r"```.*?```", re.DOTALL)
LINK: Final = re.compile(r"\]\(([^)\s]+)\)")
TEXTS: Final = (".md", ".ipynb")
SITE: Final = {ROOT / "docs" / "conf.py"}
"""Files that only the generator of the site reads."""


def main() -> int:
    """Check all pages."""
    pages = [*ROOT.glob("*.md"), *(ROOT / "simgap").glob("*.md")]
    pages += [path for path in (ROOT / "docs").rglob("*") if path.suffix in TEXTS]
    problems = [
        f"{page.relative_to(ROOT)}: {link}: leads nowhere" for page in pages for link in find_dead(page)
    ]
    problems += [f"{path.relative_to(ROOT)}: cannot be reached from README.md" for path in find_unreached()]
    print("\n".join(sorted(problems)) or f"links: those of {len(pages)} pages lead somewhere")
    return 1 if problems else 0


def text_of(page: Path) -> str:
    """Return the text of a page or notebook, without its code."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n".join("".join(one["source"]) for one in cells if one["cell_type"] == "markdown")
    return CODE.sub("", text)


def links_of(page: Path) -> set[str]:
    """Return the targets of the links and pictures of a page, but not those to other sites."""
    return {link for link in LINK.findall(text_of(page)) if ":" not in link}


def anchors_of(page: Path) -> set[str]:
    """Return the anchors that headings have on code hosts and on the site."""
    headings = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def find_dead(page: Path) -> list[str]:
    """Return the links of a page to a file or an anchor that does not exist."""
    dead = []
    for link in sorted(links_of(page)):
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if not target.exists() or (anchor and anchor not in anchors_of(target)):
            dead.append(link)
    return dead


def find_unreached() -> set[Path]:
    """Return the files of docs/ that no chain of links from the README leads to."""
    reached, waiting = set(SITE), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        if page.is_dir():
            waiting += sorted(page.glob("*.md"))
        elif page.suffix in TEXTS:
            waiting += [
                (page.parent / link.partition("#")[0]).resolve() for link in links_of(page) if link[0] != "#"
            ]
    return {path for path in (ROOT / "docs").rglob("*") if path.is_file()} - reached


if __name__ == "__main__":
    sys.exit(main())

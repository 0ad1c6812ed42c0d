"""Documents: their links lead somewhere, and every page can be reached from the README."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FIRST = ROOT / "README.md"
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "simgap").glob("*.md")],
)
CODE = re.compile(r"```.*?```", re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def links_of(page: Path) -> set[str]:
    """Return the targets of the links and pictures of a page, but not those to other sites."""
    return {link for link in LINK.findall(CODE.sub("", page.read_text())) if ":" not in link}


def anchors_of(page: Path) -> set[str]:
    """Return the anchors that headings have on code hosts and in site generators."""
    headings = re.findall(r"^#+ (.+)$", CODE.sub("", page.read_text()), re.MULTILINE)
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file_and_a_heading_that_exist(page: Path) -> None:
    assert not find_dead(page)


def test_a_dead_link_and_a_dead_anchor_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A page\n[none](none.md) [here](#a-page) [there](#other)\n```\n[code](code.md)\n```\n")
    assert find_dead(page) == ["#other", "none.md"]


def test_every_page_and_picture_can_be_reached_from_the_readme() -> None:
    reached: set[Path] = set()
    waiting = [FIRST]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        if page.is_dir():
            waiting += sorted(page.glob("*.md"))
        elif page.suffix == ".md":
            waiting += [
                (page.parent / link.partition("#")[0]).resolve() for link in links_of(page) if link[0] != "#"
            ]
    there = {path for path in (ROOT / "docs").rglob("*") if path.is_file()}
    assert there <= reached

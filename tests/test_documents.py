"""Documents: files and commands in them exist, and their steps run. `make lint` checks their links."""

import re
import runpy
import shlex
from pathlib import Path
from typing import Final

import pytest
from typer.core import TyperGroup
from typer.main import get_command

from helpers.command import call, run_simgap
from marsarm.cli.app import app as marsarm_app
from simgap.command.app import app as simgap_app
from tests.marsarm.command import marsarm
from validation import documents
from validation.campaigns import TABLE

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "simgap").glob("*.md")])
CODE = re.compile(r"```.*?```", re.DOTALL)
PARTS: Final = ("fsw", "sim", "marsarm", "simgap", "tests", "validation", "examples")
PRODUCTS: Final = {"marsarm": get_command(marsarm_app), "simgap": get_command(simgap_app)}


def test_a_dead_link_and_a_dead_anchor_are_found(tmp_path):
    links = runpy.run_path(str(ROOT / ".ci" / "links.py"))
    page = tmp_path / "page.md"
    page.write_text("# A page\n[none](none.md) [here](#a-page) [there](#other)\n```\n[code](code.md)\n```\n")
    assert links["find_dead"](page) == ["#other", "none.md"]


def test_every_file_that_a_page_names_exists():
    named = re.compile(r"`((?:fsw|sim|marsarm|simgap|tests|models|validation|examples|docs|\.ci)/[\w./-]+)`")
    there = {page.name: named.findall(page.read_text()) for page in PAGES if page.name != "CHANGELOG.md"}
    gone = {name: [file for file in files if not (ROOT / file).exists()] for name, files in there.items()}
    assert {name: files for name, files in gone.items() if files} == {}


def test_every_module_that_a_page_names_without_its_folder_exists():
    modules = {path.name for part in PARTS for path in (ROOT / part).rglob("*.py")}
    named = {name for page in PAGES for name in re.findall(r"`(\w+\.py)`", page.read_text())}
    assert named <= modules


def commands_in(text: str) -> list[list[str]]:
    """Return the words of each command of `marsarm` or `simgap`, in blocks and lines of a page."""
    in_blocks = [line for block in CODE.findall(text) for line in block.splitlines()]
    in_lines = re.findall(r"`([^`\n]+)`", CODE.sub("", text))
    lines = (line for line in (*in_blocks, *in_lines) if line.partition(" ")[0] in PRODUCTS)
    return [shlex.split(line.replace("\\|", "|"), comments=True) for line in lines]


def find_unknown(words: list[str]) -> list[str]:
    """Return the words of a command that are a verb or an option which the command line does not know."""
    command, rest = PRODUCTS[words[0]], words[1:]
    while isinstance(command, TyperGroup) and rest and not rest[0].startswith("-"):
        if rest[0] not in command.commands:
            return [rest[0]]
        command, rest = command.commands[rest[0]], rest[1:]
    if not isinstance(command, TyperGroup):
        command.read_options()
    known = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
    used = {word.partition("=")[0] for word in rest if word.startswith("--")}
    return sorted(used - known - {"--help", "--install-completion"})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_of_a_page_has_a_verb_and_options_that_exist(page):
    if page.name != "CHANGELOG.md":  # it names what is gone
        unknown = {" ".join(words): find_unknown(words) for words in commands_in(page.read_text())}
        assert {command: words for command, words in unknown.items() if words} == {}


def test_every_campaign_and_target_of_a_page_exists():
    campaign = re.compile(r"(?:NAME=|[Cc]ampaigns? `|python -m validation )([a-z][a-z0-9-]*)")
    target = re.compile(r"(?:`|^)make ([a-z-]+)", re.MULTILINE)
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for page in PAGES:
        text = page.read_text()
        assert set(campaign.findall(text)) <= {one.name for one in TABLE}, page
        assert set(target.findall(text)) <= set(targets), page


def test_an_unknown_verb_and_an_unknown_option_are_found():
    text = "`marsarm place --arm x --where y`\n```sh\nmarsarm log info run.mcap --json\nsimgap fly  # no\n```"
    assert [find_unknown(words) for words in commands_in(text)] == [[], ["fly"], ["--where"]]


def run_script(folder, path, *words):
    """Run a script in this process."""
    return call(lambda: runpy.run_path(path, run_name="__main__"), folder, *words)


PROGRAMS = {"marsarm": marsarm, "simgap": run_simgap, "python": run_script}

STEPS = [
    pytest.param(one, marks=[pytest.mark.slow] if one.tier == "slow" else [], id=f"{one.page}:{k}")
    for k, one in enumerate(documents.read_steps())
    if one.tier != "campaign"
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Make the folder in which all steps run, one after the other."""
    made = tmp_path_factory.mktemp("clone")
    documents.make_folder(made)
    return made


def run_step(step, folder):
    """Run a command of the products in this process, and any other step as a reader would."""
    if step.kind == "sh" and step.text.split()[0] in PROGRAMS and not set(step.text) & set("|>&;$"):
        program, *words = shlex.split(step.text)
        return PROGRAMS[program](folder, *words)
    return documents.run_step(step, folder)


@pytest.mark.parametrize("step", STEPS)
def test_a_step_of_a_document_succeeds(step, folder, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    done = run_step(step, folder)
    assert done.returncode == 0, f"{step.text}\n{done.stdout}\n{done.stderr}"


def test_every_reason_to_leave_out_a_command_is_used():
    left_out = [
        one for page in documents.PAGES for one in documents.read_page(page) if documents.why_left_out(one)
    ]
    assert all(any(f"{one.text} ".startswith(start) for one in left_out) for start in documents.LEFT_OUT)


def test_a_page_gives_its_files_its_blocks_and_the_commands_in_its_lines(tmp_path, monkeypatch):
    monkeypatch.setattr("validation.documents.ROOT", tmp_path)
    (tmp_path / "page.md").write_text(
        "`marsarm log info run.mcap` `marsarm log`\n```sh\nmarsarm arm  # lists\n```\n"
        "```toml\n# rock.toml\nseed = 1\n```\n```python\nprint(1)\n```\n```\nmarsarm no\n```\n"
    )
    assert list(documents.read_page("page")) == [
        documents.Step("page", "file", "# rock.toml\nseed = 1\n", "rock.toml"),
        documents.Step("page", "sh", "marsarm arm"),
        documents.Step("page", "python", "print(1)\n"),
        documents.Step("page", "sh", "marsarm log info run.mcap"),
    ]

"""Commands and Python blocks of the documents run as they stand; a campaign runs the long ones."""

import runpy
import shlex

import pytest

from helpers.command import call, run_simgap
from tests.marsarm.command import marsarm
from validation import documents


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

"""Commands and Python blocks of the documents run as they stand; a campaign runs the long ones."""

import pytest

from validation.documents import (
    LEFT_OUT,
    PAGES,
    Step,
    make_folder,
    read_page,
    read_steps,
    run_step,
    why_left_out,
)

STEPS = [
    pytest.param(one, marks=[pytest.mark.slow] if one.tier == "slow" else [], id=f"{one.page}:{k}")
    for k, one in enumerate(read_steps())
    if one.tier != "campaign"
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Make the folder in which all steps run, one after the other."""
    made = tmp_path_factory.mktemp("clone")
    make_folder(made)
    return made


@pytest.mark.parametrize("step", STEPS)
def test_a_step_of_a_document_succeeds(step, folder):
    done = run_step(step, folder)
    assert done.returncode == 0, f"{step.text}\n{done.stdout}\n{done.stderr}"


def test_every_reason_to_leave_out_a_command_is_used():
    left_out = [one for page in PAGES for one in read_page(page) if why_left_out(one)]
    assert all(any(f"{one.text} ".startswith(start) for one in left_out) for start in LEFT_OUT)


def test_a_page_gives_its_blocks_its_files_and_the_commands_in_its_lines(tmp_path, monkeypatch):
    monkeypatch.setattr("validation.documents.ROOT", tmp_path)
    (tmp_path / "page.md").write_text(
        "`marsarm log info run.mcap` `marsarm log`\n```sh\nmarsarm arm  # lists\n```\n"
        "```toml\n# rock.toml\nseed = 1\n```\n```python\nprint(1)\n```\n```\nmarsarm no\n```\n"
    )
    assert list(read_page("page")) == [
        Step("page", "sh", "marsarm arm"),
        Step("page", "file", "# rock.toml\nseed = 1\n", "rock.toml"),
        Step("page", "python", "print(1)\n"),
        Step("page", "sh", "marsarm log info run.mcap"),
    ]

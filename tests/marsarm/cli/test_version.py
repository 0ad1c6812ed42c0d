"""Options that stand without a verb: the version, and the completion of the shell."""

import os
import subprocess
import sys
from importlib.metadata import version

import pytest

from helpers.marks import slow_but
from tests.marsarm.command import ROOT, marsarm

AS_INSTALLED = "import sys; sys.argv[0] = 'marsarm'; from marsarm.__main__ import start; start()"


def test_the_version_is_that_of_the_package(tmp_path):
    done = marsarm(tmp_path, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"marsarm {version('marsarm')}\n", "")


COMPLETIONS = {"marsarm re": {"reach", "replay"}, "marsarm ik --js": {"--json"}}


@pytest.mark.parametrize("words", slow_but(COMPLETIONS, "marsarm ik --js"))
def test_the_shell_completes_verbs_and_options(words):
    asked = {"_MARSARM_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    command = [sys.executable, "-c", AS_INSTALLED]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | asked, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == COMPLETIONS[words]


@pytest.mark.parametrize(("shell", "begin"), [("fish", "--"), ("zsh", '"--')])
def test_the_shell_shows_the_help_of_each_option_as_it_stands_on_one_line(shell, begin):
    words = {"_TYPER_COMPLETE_ARGS": "marsarm place --", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    env = os.environ | words | {"_MARSARM_COMPLETE": f"complete_{shell}"}
    command = [sys.executable, "-c", AS_INSTALLED]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=True)
    lines = done.stdout.removeprefix("_arguments '*: :((").splitlines()
    assert len(lines) > 10
    assert all(line.startswith(begin) for line in lines)


def test_the_citation_has_the_version_of_the_package():
    assert f"\nversion: {version('marsarm')}\n" in (ROOT / "CITATION.cff").read_text()

"""Options that stand without a verb: the version, and the completion of the shell."""

import os
import subprocess
import sys
from importlib.metadata import version

from tests.marsarm.command import ROOT, marsarm

AS_INSTALLED = "import sys; sys.argv[0] = 'marsarm'; from marsarm.__main__ import start; start()"


def test_the_version_is_that_of_the_package(tmp_path):
    done = marsarm(tmp_path, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"marsarm {version('marsarm')}\n", "")


def test_the_shell_completes_verbs_and_options():
    for words, expected in (
        ("marsarm re", {"reach", "replay"}),
        ("marsarm ik --js", {"--json"}),
    ):
        variables = {
            "_MARSARM_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(words.count(" ")),
        }
        done = subprocess.run(
            [sys.executable, "-c", AS_INSTALLED],
            cwd=ROOT,
            env=os.environ | variables,
            capture_output=True,
            text=True,
            check=True,
        )
        assert set(done.stdout.split()) == expected


def test_the_citation_has_the_version_of_the_package():
    assert f"\nversion: {version('marsarm')}\n" in (ROOT / "CITATION.cff").read_text()

"""Options of verbs and of their requests are the same, and checked as declared; options without a verb."""

import inspect
from dataclasses import MISSING, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import pytest

from helpers.command import run_python
from helpers.marks import slow_but
from marsarm.accuracy.request import BudgetRequest, MonteCarloRequest
from marsarm.cli import analysis, diagnosis, runs
from marsarm.common.options import ArmRequest, CalibrateRequest, ViewRequest
from marsarm.diagnosis.arm.request import DiagnoseRequest, NextRequest, RecordRequest
from marsarm.ik.request import IkRequest, ReachRequest
from marsarm.runs.request import HardstopRequest, PlaceRequest, RunRequest
from simgap.command import app
from simgap.command import request as simgap_request
from simgap.common.app import give_address
from simgap.common.errors import BadRequest
from simgap.common.options import Option, check_options, option_fields
from simgap.common.verb import VerbResult, verb
from tests.marsarm.command import ROOT, marsarm

VERBS = {
    PlaceRequest: runs.place,
    RunRequest: runs.run,
    HardstopRequest: runs.hardstop,
    IkRequest: analysis.ik,
    ReachRequest: analysis.reach,
    BudgetRequest: analysis.budget,
    MonteCarloRequest: analysis.monte_carlo,
    CalibrateRequest: analysis.calibrate,
    ArmRequest: analysis.arm,
    ViewRequest: runs.view,
    DiagnoseRequest: diagnosis.diagnose,
    RecordRequest: diagnosis.record,
    NextRequest: diagnosis.propose,
    simgap_request.CheckRequest: app.check,
    simgap_request.DiagnoseRequest: app.diagnose,
    simgap_request.NextRequest: app.propose,
}
HEAVY = ("numpy", "pydantic", "mujoco", "scipy", "pyarrow", "sim", "fsw", "marsarm.runs.request")


def options_of(request_type, group=MISSING):
    """Yield name, declaration and default of each option, also of those in groups."""
    for field in option_fields(request_type):
        default = field.default if group is MISSING else getattr(group, field.name)
        if field.option is None:
            yield from options_of(field.type, default)
        else:
            yield field.name, field.option, default


@pytest.mark.parametrize("request_type", VERBS, ids=lambda kind: kind.__name__)
def test_a_verb_has_the_options_of_its_request(request_type):
    parameters = inspect.signature(VERBS[request_type].read_options()).parameters
    for name, option, default in options_of(request_type):
        _, declared = get_args(parameters[name].annotation)
        assert declared.help == option.help
        assert option.help.endswith(".")
        shown = parameters[name].default
        assert shown in (default, None if default == () else inspect.Parameter.empty)


def test_the_command_line_loads_no_domain_before_a_verb_runs():
    ask = f"import sys, marsarm.cli.app; print([name for name in {HEAVY} if name in sys.modules])"
    assert run_python(ROOT, "-c", ask).stdout == "[]\n"


@dataclass(frozen=True)
class Files:
    out: Annotated[Path | None, Option("Out.", suffixes=(".csv",), help_without="None.")] = None


@dataclass(frozen=True)
class Request:
    table: Annotated[tuple[str, ...], Option("Tables.", is_argument=True, is_read=True)] = ()
    size: Annotated[float, Option("Size.", within=(0.5, 2.0))] = 1.0
    seed: Annotated[int, Option("Seed.", within=(0, None))] = 0
    kind: Annotated[Literal["a", "b"], Option("Kind.")] = "a"
    files: Files = Files(Path("out.csv"))
    hidden: int = 7


@pytest.mark.parametrize(
    ("request_", "sentence"),
    [
        (Request(size=3.0), "size: 3 is not within 0.5 .. 2"),
        (Request(seed=-1), "seed: -1 is below 0"),
        (Request(size="3"), "size: takes a number, not '3'"),
        (Request(size=True), "size: takes a number, not True"),
        (Request(seed=1.5), "seed: takes a whole number, not 1.5"),
        (Request(seed=None), "seed: takes a whole number, not None"),
        (Request("a.csv"), "table: takes a tuple, each item a text, not 'a.csv'"),
        (Request(files=None), "files: takes a Files, not None"),
        (Request(files=Files("out.csv")), "out: takes a pathlib.Path, not 'out.csv'"),
        (Request(kind=3), "kind: 3 is not known; there are a, b"),
        (Request(kind="c"), "kind: 'c' is not known; there are a, b"),
        (Request(files=Files(Path("out.txt"))), "out out.txt: its name must end in .csv"),
        (Request(("a.toml",), files=Files(Path("a.toml"))), "out a.toml: this is the file of table a.toml"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused(request_, sentence):
    with pytest.raises(BadRequest) as error:
        check_options(request_)
    assert str(error.value).startswith(sentence)


def test_what_is_allowed_is_not_refused(tmp_path):
    check_options(Request(("name", "a.toml"), 0.5, 3, "b", Files(tmp_path / "out.csv")))
    check_options(Request(files=Files(None)))
    check_options(Request(["name"], np.float32(1.0), np.int64(3)))


def test_a_request_is_built_from_the_options(capsys):
    requests = []

    @verb
    def work(request: Request) -> VerbResult:
        requests.append(request)
        return VerbResult({"size": request.size}, lambda: print("a table"))

    given = {name: one.default for name, one in inspect.signature(work.read_options()).parameters.items()}
    work(**given)
    work(**given | {"table": ["x"], "size": 2.0, "no_out": True, "as_json": True})
    assert requests == [Request(), Request(("x",), 2.0, files=Files(None))]
    assert capsys.readouterr().out == 'a table\n{\n  "size": 2.0\n}\n'


@pytest.mark.parametrize(
    ("words", "address"),
    [
        (["--cluster"], "auto"),
        (["--cluster", "--arms", "3"], "auto"),
        (["--cluster", "logs"], "auto"),
        (["--cluster", "head:6379"], "head:6379"),
        (["--cluster", "10.0.0.1:6379", "logs"], "10.0.0.1:6379"),
        (["--cluster", "auto"], "auto"),
    ],
)
def test_the_option_cluster_may_stand_without_an_address(words, address):
    complete = list(give_address(words))
    assert complete[complete.index("--cluster") + 1] == address
    assert [word for word in complete if word != "auto"] == [word for word in words if word != "auto"]


def test_without_a_verb_the_help_is_printed(tmp_path):
    told = marsarm(tmp_path, "log")
    assert (told.returncode, told.stderr) == (2, "")
    assert told.stdout.startswith("Usage: marsarm log [OPTIONS] COMMAND [ARGS]...")
    assert told.stdout == marsarm(tmp_path, "log", "--help").stdout


def test_a_list_of_verbs_has_whole_sentences(tmp_path):
    words = " ".join(marsarm(tmp_path, "--help").stdout.split())
    assert "place Unstow, place an instrument on a rock, and retract." in words
    assert "why arm and simulation differ, or try it." in words
    assert "..." not in words.partition("Commands:")[2]


AS_INSTALLED = "import sys; sys.argv[0] = 'marsarm'; from marsarm.__main__ import start; start()"


def test_the_version_is_that_of_the_package(tmp_path):
    done = marsarm(tmp_path, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"marsarm {version('marsarm')}\n", "")


COMPLETIONS = {"marsarm re": {"reach", "replay"}, "marsarm ik --js": {"--json"}}


@pytest.mark.parametrize("words", slow_but(COMPLETIONS, "marsarm ik --js"))
def test_the_shell_completes_verbs_and_options(words):
    asked = {"_MARSARM_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    done = run_python(ROOT, "-c", AS_INSTALLED, **asked)
    assert set(done.stdout.split()) == COMPLETIONS[words]


@pytest.mark.parametrize(("shell", "begin"), [("fish", "--"), ("zsh", '"--')])
def test_the_shell_shows_the_help_of_each_option_as_it_stands_on_one_line(shell, begin):
    words = {"_TYPER_COMPLETE_ARGS": "marsarm place --", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    words |= {"_MARSARM_COMPLETE": f"complete_{shell}"}
    done = run_python(ROOT, "-c", AS_INSTALLED, **words)
    lines = done.stdout.removeprefix("_arguments '*: :((").splitlines()
    assert len(lines) > 10
    assert all(line.startswith(begin) for line in lines)


def test_the_citation_has_the_version_of_the_package():
    assert f"\nversion: {version('marsarm')}\n" in (ROOT / "CITATION.cff").read_text()

"""Output that ends early: Ctrl-C, a full disk, a closed pipe; no file is left behind, and a log says so."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from helpers.command import handlers_kept, run_python
from helpers.marks import slow_but
from marsarm.ik.solve import IkModel
from marsarm.telemetry.format import LogNotWritable
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.recover import recover
from simgap.common import interruption
from simgap.common.errors import BadOutput
from simgap.common.files import atomic_write, check_unlocked
from tests.marsarm.command import ROOT, marsarm, marsarm_json
from tests.marsarm.telemetry.lab import cycle_at

RUN = [sys.executable, "-c", "from marsarm.__main__ import start; start()"]


@pytest.fixture(autouse=True)
def end_by_signals(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let no test be ended by the grace of a signal that another one has survived."""
    monkeypatch.setattr("simgap.common.interruption._end_late", lambda number: None)
    with handlers_kept():
        for number in interruption.END_SIGNALS:
            signal.signal(number, signal.SIG_DFL)  # pytest in the background of a shell ignores SIGINT
        yield


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_verb_says_so_in_one_sentence(tmp_path, monkeypatch, number, status):
    monkeypatch.setattr(IkModel, "solve", lambda *_: signal.raise_signal(number))
    done = marsarm(tmp_path, "reach", "--json")
    sentence = f"interrupted by {number.name} before the end"
    assert (done.returncode, done.stderr) == (status, f"{sentence}\n")
    assert json.loads(done.stdout) == {"error": sentence}
    assert not list(tmp_path.iterdir())


def test_a_signal_in_a_deferred_section_is_raised_at_its_end():
    done = []
    interruption.raise_on_signals()
    with pytest.raises(interruption.Interrupted, match="SIGINT"), interruption.defer_interrupts:  # noqa: PT012
        with interruption.defer_interrupts:
            signal.raise_signal(signal.SIGINT)
            done.append("inner")
        done.append("outer")
    assert done == ["inner", "outer"]


def test_a_second_signal_does_not_disturb_the_end():
    interruption.raise_on_signals()
    with pytest.raises(interruption.Interrupted):
        signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGTERM)


def test_a_signal_while_an_extension_is_imported_is_an_interruption(capsys):
    def import_extension() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except interruption.Interrupted as interrupted:
            raise ImportError("initialization failed") from interrupted

    with pytest.raises(SystemExit) as end, interruption.report_interruption():
        import_extension()
    assert end.value.code == 130
    assert capsys.readouterr().err == "interrupted by SIGINT before the end\n"


def test_another_error_is_no_interruption():
    with pytest.raises(ImportError), interruption.report_interruption():
        raise ImportError("no such module")


def test_a_signal_between_a_new_file_and_its_block_leaves_no_file(tmp_path):
    def write() -> None:
        writer = atomic_write(tmp_path / "result.json", "out")
        writer.__enter__()
        assert [one.suffix for one in tmp_path.iterdir()] == [".part"]
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(SystemExit), interruption.report_interruption():
        write()
    assert list(tmp_path.iterdir()) == []


def test_the_log_of_an_interrupted_run_says_so_to_every_reader(tmp_path):
    log = tmp_path / "run.mcap"
    with pytest.raises(interruption.Interrupted), Recorder(log, {"seed": "1"}) as recorder:  # noqa: PT012
        for tick in range(8):
            recorder.write(cycle_at(tick))
        raise interruption.Interrupted(signal.SIGINT)
    read = read_log(log)
    assert (read.end, read.interrupted_by, read.truncated, len(read["/joint"])) == (
        "interrupted", "SIGINT", False, 8,
    )  # fmt: skip
    sentence = "the run was interrupted by SIGINT; the log ends there"
    for words in (("info",), ("info", "*"), ("export", "tables")):
        done = marsarm(tmp_path, "log", words[0], "run.mcap", *words[1:])
        assert (done.returncode, done.stderr) == (0, f"log run.mcap: {sentence}\n")
    assert f" {sentence}\n" in marsarm(tmp_path, "log", "info", "run.mcap").stdout
    document = marsarm_json(tmp_path, "log", "info", "run.mcap")
    end = {name: document[name] for name in ("closed", "end", "interrupted_by")}
    assert end == {"closed": False, "end": "interrupted", "interrupted_by": "SIGINT"}
    recover(log, tmp_path / "good.mcap", lambda *_: None)
    assert read_log(tmp_path / "good.mcap").interrupted_by == "SIGINT"


def test_a_log_that_nobody_closed_is_interrupted_and_one_that_was_is_closed(tmp_path):
    recorder = Recorder(tmp_path / "run.mcap", {})
    recorder.write(cycle_at(0))
    del recorder
    assert read_log(tmp_path / "run.mcap").end == "interrupted"
    with Recorder(tmp_path / "whole.mcap", {}) as whole:
        whole.write(cycle_at(0))
    assert read_log(tmp_path / "whole.mcap").end == "closed"


def test_a_log_belongs_to_one_run_at_a_time(tmp_path):
    path = tmp_path / "run.mcap"
    with Recorder(path, {}) as recorder:
        recorder.write(cycle_at(0))
        for refused in (lambda: check_unlocked(path, "log"), lambda: Recorder(path, {})):
            with pytest.raises((BadOutput, LogNotWritable), match="another run is writing it"):
                refused()
    check_unlocked(path, "log")
    assert len(read_log(path)["/joint"]) == 1


LATE = """
import sys, time
from simgap.common.interruption import report_interruption
with report_interruption():
    import signal
    try:
        signal.raise_signal(signal.SIGINT)
    except BaseException:
        if sys.argv[1] == "swallow":
            time.sleep(60)
        __import__("atexit").register(time.sleep, 60)
        raise
"""


SLOW_ENDS = [("swallow", "; it did not end by itself"), ("end slowly", "")]


@pytest.mark.parametrize(("what", "rest"), slow_but(SLOW_ENDS, SLOW_ENDS[0]))
def test_an_interruption_that_takes_long_is_ended_with_one_sentence(tmp_path, what, rest):
    done = run_python(tmp_path, "-c", LATE, what, "--json", timeout_s=50, PYTHONPATH=str(ROOT))
    sentence = f"interrupted by SIGINT before the end{rest}"
    assert (done.returncode, done.stderr) == (130, f"{sentence}\n")
    assert json.loads(done.stdout) == {"error": sentence}


@pytest.mark.slow
def test_of_two_runs_that_write_one_log_the_second_is_refused_before_anything_moves(tmp_path):
    words = ["place", "--log", "run.mcap", "--no-picture"]
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    first = subprocess.Popen([*RUN, *words], cwd=tmp_path, env=env, text=True, stderr=subprocess.PIPE)
    try:
        while not (tmp_path / "run.mcap").exists():
            time.sleep(0.05)
        second = marsarm(tmp_path, *words)
    finally:
        first.send_signal(signal.SIGINT)
        _, errors = first.communicate(timeout=60)
    assert second.returncode == 2
    assert second.stderr == "log run.mcap: another run is writing it; wait for it, or give another file\n"
    assert first.returncode == 130
    assert errors.splitlines()[-1].startswith("interrupted by SIGINT before the end; log run.mcap ends at ")
    assert read_log(tmp_path / "run.mcap").end == "interrupted"


def to(target, *words):
    return subprocess.run(
        ["bash", "-c", f'set -o pipefail; "$@" {target}', "-", *RUN, *words],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


def list_errors(ran):
    """List the lines on standard error, but for the progress that a slow machine shows."""
    lines = ran.stderr.splitlines()
    return [line for line in lines if re.fullmatch(r".+ after \d+ s, .+", line) is None]


@pytest.mark.parametrize("words", slow_but([["dictionary", "--json"], ["--help"]], ["--help"]))
def test_a_full_disk_behind_the_output_is_said(words):
    ran = to("> /dev/full", *words)
    assert ran.returncode == 2
    said = "standard output: cannot be written (No space left on device); give it room"
    assert list_errors(ran) == [said]


def test_a_reader_that_has_enough_ends_it_quietly():
    ran = to("| head -c 1 > /dev/null", "dictionary", "--json")
    assert list_errors(ran) == []
    assert ran.returncode in (0, 141)  # 0 where all of it fits into the pipe


@pytest.mark.slow
def test_all_of_it_arrives(tmp_path):
    piped = to("| cat", "dictionary", "--json")
    assert (piped.returncode, list_errors(piped)) == (0, [])
    assert piped.stdout == marsarm(tmp_path, "dictionary", "--json").stdout

"""Tests of the runner on the cores of this machine; `test_cluster.py` has those on a cluster."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from multiprocessing import active_children

import pytest

from helpers.command import handlers_kept
from marsarm.common.pool import WorkersDied, in_order, local_runner, run_here, select_runner
from marsarm.ik.reach import reach
from marsarm.ik.request import ReachRequest
from simgap.common.errors import BadRequest
from tests.marsarm.command import ROOT
from tests.marsarm.common.work import die, die_once, interrupted_after, power, rest, square
from validation.campaigns import Context
from validation.hardstops import campaign as hardstops


def process(_: int) -> int:
    return os.getpid()


def test_processes_stay_for_the_next_call():
    run = local_runner(2)
    first, second = (set(run(process, range(9))) for _ in range(2))
    assert os.getpid() not in first
    assert len(first | second) <= 2


def test_an_error_of_the_work_is_not_swallowed_and_the_next_call_works():
    run = local_runner(2)
    with pytest.raises(TypeError):
        list(run(square, ["x"]))
    assert sorted(run(square, range(3))) == [0, 1, 4]


def test_without_ray_a_cluster_is_refused_with_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(BadRequest, match=r"ray is not installed; pip install 'marsarm\[cluster\]'"):
        select_runner(None, "auto")


@pytest.mark.parametrize("workers", [1, 2])
def test_results_can_come_in_the_order_of_their_jobs(workers):
    assert list(in_order(local_runner(workers), power, [(x, 2) for x in range(50)])) == [
        x * x for x in range(50)
    ]


@pytest.mark.slow
def test_a_reach_map_and_a_campaign_of_the_closed_loop_are_those_of_one_process():
    request = ReachRequest(samples=20_000, picture=None)
    assert reach(replace(request, workers=2)).tally == reach(replace(request, workers=1)).tally
    two, one = (json.dumps(hardstops(Context(3, run), 1, 2, "ELBOW")) for run in (local_runner(2), run_here))
    assert two == one


def test_a_worker_that_dies_costs_the_jobs_under_way_only(tmp_path, capfd):
    assert len(list(local_runner(2)(die_once, [tmp_path] * 20))) == 20
    assert capfd.readouterr().err == "a worker died; its work items are repeated\n"


SLOW_TO_LOAD = """
import os, pathlib, time
if "IN_A_WORKER" in os.environ:
    pathlib.Path("starts").touch()
    time.sleep(30)
def work(_): ...
"""
MAIN = """
import os
from simgap.common.interruption import report_interruption
from marsarm.common.pool import local_runner
from slow import work
os.environ["IN_A_WORKER"] = "1"
with report_interruption():
    list(local_runner(2)(work, [1] * 4))
"""


@pytest.mark.slow
def test_ctrl_c_while_workers_start_gives_one_sentence(tmp_path):
    (tmp_path / "slow.py").write_text(SLOW_TO_LOAD)
    (tmp_path / "main.py").write_text(MAIN)
    with handlers_kept():
        signal.signal(signal.SIGINT, signal.default_int_handler)  # which the process inherits
        process = subprocess.Popen(
            [sys.executable, "main.py"], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)},
            stderr=subprocess.PIPE, text=True, process_group=0,
        )  # fmt: skip
    while not (tmp_path / "starts").exists():
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (130, "interrupted by SIGINT before the end\n")


@pytest.mark.slow
def test_a_job_at_which_every_worker_dies_ends_the_run():
    with pytest.raises(WorkersDied, match="3 of them died one after the other"):
        list(local_runner(2)(die, [1]))


def square_or_fail(x: int) -> int:
    if x == 900:
        raise ValueError("900 is not allowed")
    return x * x


@pytest.mark.slow
def test_results_before_an_error_are_kept():
    found = []
    with pytest.raises(ValueError, match="900 is not allowed"):
        found.extend(found.append(one) for one in local_runner(2)(square_or_fail, range(1000)))
    assert len(set(found)) >= 900 - 1000 // 4  # the other worker may still have a task, a quarter at most


@pytest.mark.slow
def test_an_interruption_kills_the_workers():
    with interrupted_after(2.0):
        list(local_runner(2)(rest, range(4)))
    assert not active_children()

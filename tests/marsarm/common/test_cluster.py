"""The pool on a real Ray cluster of two nodes on the loopback; skipped where Ray is not installed."""

import json
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec

import pytest

from marsarm.accuracy.monte_carlo import ArmJob, run_job, run_monte_carlo
from marsarm.accuracy.request import MonteCarloRequest
from marsarm.common import pool
from marsarm.common.pool import Runner, WorkersDied, in_order, run_here, select_runner
from sim.arms import nominal_params
from simgap.common.errors import BadRequest
from simgap.common.progress import no_progress
from tests.marsarm.command import marsarm_json
from tests.marsarm.common.work import (
    die,
    die_once,
    interrupted_after,
    node_id,
    power,
    rest,
    square,
    square_or_fail,
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed: no cluster is tried"),
    pytest.mark.filterwarnings("default"),  # ray's own
]


@dataclass(frozen=True, slots=True)
class LoopbackCluster:
    """Cluster of a head and another node, with a processor each."""

    address: str
    kill_node: Callable[[], None]
    """Kill the other node at once, with its workers."""


@contextmanager
def start_two_nodes() -> Iterator[LoopbackCluster]:
    """Start a cluster whose nodes listen on the loopback only, and connect to it."""
    # Read when ray is imported. Without the first, nodes listen at the address of the machine.
    os.environ |= {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}
    import ray
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "node_ip_address": "127.0.0.1", "include_dashboard": False}
    node["object_store_memory"] = 80 * 2**20
    cluster = Cluster(initialize_head=True, head_node_args=node)
    try:
        other = cluster.add_node(**node)
        cluster.wait_for_nodes()
        yield LoopbackCluster(cluster.address, lambda: cluster.remove_node(other, allow_graceful=False))
    finally:
        ray.shutdown()
        cluster.shutdown()


def list_arms(count: int, seed: int) -> list[ArmJob]:
    """List jobs of the Monte Carlo of the error budget, one place each."""
    request = MonteCarloRequest("mars", move_model="statics", seed=seed)
    return [(request, nominal_params(), arm) for arm in range(count)]


def measure_arms(run: Runner, jobs: Sequence[ArmJob], after: Callable[[int], None] = lambda _: None) -> str:
    """Run arms; return their records as text, in which every bit shows.

    `after` is called with the number of results, after each.
    """
    records = []
    for record in run(run_job, jobs):
        records.append(record)
        after(len(records))
    return json.dumps(sorted(records, key=lambda record: int(record["arm"])))


@pytest.fixture(scope="module")
def nodes() -> Iterator[LoopbackCluster]:
    with start_two_nodes() as found:
        yield found


@pytest.fixture
def run(nodes) -> Runner:
    return select_runner(None, nodes.address)


@pytest.fixture(scope="module")
def one_process() -> str:
    return measure_arms(run_here, list_arms(200, 7))


def test_two_hundred_arms_are_those_of_one_process_bit_for_bit(run, one_process):
    assert measure_arms(run, list_arms(200, 7)) == one_process


def test_every_job_is_done_once_and_results_can_come_in_order(run):
    assert sorted(run(square, range(20_000))) == [x * x for x in range(20_000)]
    assert list(in_order(run, power, [(x, 2) for x in range(50)])) == [x * x for x in range(50)]


def test_both_nodes_work(run):
    found = set()
    for _ in range(100):  # a worker takes seconds to start
        found |= set(run(node_id, range(4)))
        if len(found) == 2:
            return
    pytest.fail(f"only {found} worked")


def test_a_worker_that_dies_costs_its_jobs_only(run, tmp_path):
    assert len(list(run(die_once, [tmp_path] * 20))) == 20


def test_a_job_at_which_every_worker_dies_ends_the_run(run):
    with pytest.raises(WorkersDied, match="3 of them died"):
        list(run(die, [1]))


def test_an_error_names_the_node(run):
    with pytest.raises(BadRequest, match=f"node {platform.node()}: 900 is not allowed"):
        list(run(square_or_fail, range(1000)))


def test_a_node_with_other_software_is_refused(run, monkeypatch):
    ours = pool.describe_computer(("fsw",))
    monkeypatch.setattr(pool, "describe_computer", lambda _: ours | {"numpy": "1.0"})
    with pytest.raises(BadRequest, match=r"has numpy [\d.]+ and not 1\.0, sources .*; make it equal"):
        list(run(square, [1]))


@pytest.mark.parametrize("again", [False, True])
def test_only_the_death_of_a_worker_repeats_its_jobs(run, monkeypatch, again):
    from ray.exceptions import NodeDiedError, OutOfDiskError

    fetched, result = [], Future.result
    error = NodeDiedError("gone") if again else OutOfDiskError("the disk is full.\nMore.")

    def fail_once(future: Future, timeout: float | None = None) -> object:
        fetched.append(future)
        if len(fetched) == 1:
            raise error
        return result(future, timeout)

    monkeypatch.setattr(Future, "result", fail_once)
    if again:
        assert list(run(square, [3])) == [9]
    else:
        with pytest.raises(pool.ClusterFailed, match=r"carry out a task \(.*the disk is full\); see `ray"):
            list(run(square, [3]))


def test_an_interruption_ends_the_run_within_two_seconds(run):
    with interrupted_after(3.0):
        list(run(rest, range(4)))
    assert list(run(square, [3])) == [9]  # a worker is free again


def test_monte_carlo_writes_its_results_as_they_come(nodes, tmp_path):
    path, rows = tmp_path / "r.jsonl", []
    request = MonteCarloRequest(arms=60, move_model="statics", seed=3, cluster=nodes.address, results=path)
    run_monte_carlo(request, lambda *_: rows.append(len(path.read_text().splitlines())))
    assert rows == list(range(1, 62))
    there = sorted(map(json.loads, path.read_text().splitlines()[1:]), key=lambda record: record["arm"])
    alone = tmp_path / "alone.jsonl"
    run_monte_carlo(replace(request, cluster=None, workers=1, results=alone), no_progress)
    assert there == [json.loads(line) for line in alone.read_text().splitlines()[1:]]


def test_the_option_alone_takes_the_cluster_of_the_environment(nodes, tmp_path, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", nodes.address)
    words = ("monte-carlo", "--cluster", "--arms", "3", "--move-model", "statics")
    assert marsarm_json(tmp_path, *words)["arms"] == 3


# Last: it has a cluster of its own, and a process is connected to one at a time.
def test_a_node_that_is_killed_half_way_changes_nothing(nodes, one_process):
    import ray

    ray.shutdown()
    with start_two_nodes() as two:
        after = []

        def kill_half_way(done: int) -> None:
            if done == 100:
                two.kill_node()
            after.append(done)

        assert measure_arms(select_runner(None, two.address), list_arms(200, 7), kill_half_way) == one_process
        assert len(after) == 200

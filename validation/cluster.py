"""Benchmark of a Ray cluster of two nodes on the loopback: equal bits, a killed node, overhead.

The same arms run in one process, on the cluster, and on the cluster while a node is killed half way.
The overhead is the median ratio of times on the cluster and in as many local processes, measured alternately.
"""

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Final

from fsw.config import digest
from fsw.dictionary.params import Params
from marsarm.accuracy.monte_carlo import ArmJob, run_job
from marsarm.accuracy.request import MoveModel
from marsarm.common.pool import Runner, cluster_runner, local_runner
from sim.params import nominal_params
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document

LOOPBACK: Final = "127.0.0.1"
STORE_BYTES: Final = 80 * 2**20
MOST_OVERHEAD: Final = 0.05
NODES: Final = 2


@dataclass(frozen=True, slots=True)
class LoopbackCluster:
    """Cluster of a head and another node, with a processor each."""

    address: str
    kill_node: Callable[[], None]
    """Kill the other node at once, with its workers."""


@contextmanager
def start_two_nodes() -> Iterator[LoopbackCluster]:
    """Start a cluster whose nodes listen on the loopback only, and connect to it.

    Raises:
        BadRequest: Ray is not installed.
    """
    # Read when ray is imported. Without the first, nodes listen at the address of the machine.
    os.environ |= {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}
    try:
        import ray
        from ray.cluster_utils import Cluster
    except ImportError as error:
        raise BadRequest("cluster: ray is not installed; pip install 'marsarm[cluster]'") from error
    node = {
        "num_cpus": 1,
        "node_ip_address": LOOPBACK,
        "include_dashboard": False,
        "object_store_memory": STORE_BYTES,
    }
    cluster = Cluster(initialize_head=True, head_node_args=node)
    try:
        other = cluster.add_node(**node)
        cluster.wait_for_nodes()
        yield LoopbackCluster(cluster.address, lambda: cluster.remove_node(other, allow_graceful=False))
    finally:
        ray.shutdown()
        cluster.shutdown()


def list_arms(count: int, seed: int, move_model: MoveModel = "statics") -> list[ArmJob]:
    """List jobs of the Monte Carlo of the error budget, one place each."""
    params: Params = nominal_params()
    own = (params, digest(params))
    return [ArmJob("mars", "sampled", 1, move_model, seed, arm, *own) for arm in range(count)]


def measure_arms(run: Runner, jobs: Sequence[ArmJob], after: Callable[[int], None] = lambda _: None) -> str:
    """Run arms; return their records as text, in which every bit shows.

    Args:
        run: Runner of parallel jobs.
        after: Called with the number of results, after each.
    """
    records = []
    for record in run(run_job, jobs):
        records.append(record)
        after(len(records))
    return json.dumps(sorted(records, key=lambda record: int(record["arm"])))


def compare(jobs: Sequence[ArmJob], pairs: int) -> Document:
    """Compare one process, as many local processes as nodes, and the cluster."""
    one_process = measure_arms(local_runner(1), jobs)
    local = local_runner(NODES)
    with start_two_nodes() as cluster:
        there = cluster_runner(cluster.address)
        equal = measure_arms(there, jobs) == one_process
        measure_arms(local, jobs)  # its processes start
        times = [(_time(there, jobs), _time(local, jobs)) for _ in range(pairs)]

        def kill_half_way(done: int) -> None:
            if done == len(jobs) // 2:
                cluster.kill_node()

        equal_after = measure_arms(there, jobs, kill_half_way) == one_process
    overhead = median(remote / here for remote, here in times) - 1.0
    return {
        "arms": len(jobs),
        "equal": equal,
        "equal_though_a_node_was_killed": equal_after,
        "pairs_s": times,
        "overhead": overhead,
        "in_bounds": equal and equal_after and overhead <= MOST_OVERHEAD,
    }


def _time(run: Runner, jobs: Sequence[ArmJob]) -> float:
    began_s = time.perf_counter()
    measure_arms(run, jobs)
    return time.perf_counter() - began_s


def campaign(context: Context, arms: int = 200, pairs: int = 25) -> Document:
    """Compare two nodes with one process.

    Args:
        context: Gives the seed.
        arms: Arms of each run.
        pairs: Pairs of times.
    """
    if min(arms, pairs) < 1:
        raise BadRequest("set: arms and pairs are 1 or more")
    return compare(list_arms(arms, context.seed), pairs)

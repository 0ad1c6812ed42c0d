"""Benchmark of a Ray cluster of two nodes on the loopback: equal bits, a killed node, overhead, cost.

The same arms run in one process, on the cluster, and on the cluster while a node is killed half way.
The overhead is the median ratio of times on the cluster and in as many local processes, measured alternately;
that of processor time counts Ray's own processes, and suits a machine that is not idle.
"""

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
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
COST_ARMS: Final = (10_000, 1_000_000)


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
        began = time.perf_counter()
        there = cluster_runner(cluster.address)
        equal = measure_arms(there, jobs) == one_process
        first_s = time.perf_counter() - began
        measure_arms(local, jobs)  # its processes start
        times = [(_time(there, jobs), _time(local, jobs)) for _ in range(pairs)]

        def kill_half_way(done: int) -> None:
            if done == len(jobs) // 2:
                cluster.kill_node()

        equal_after = measure_arms(there, jobs, kill_half_way) == one_process
    overhead, cpu_overhead = (median(remote[k] / here[k] for remote, here in times) - 1.0 for k in range(2))
    return {
        "arms": len(jobs),
        "equal": equal,
        "equal_though_a_node_was_killed": equal_after,
        "first_run_s": first_s,
        "pairs_s": times,
        "overhead": overhead,
        "cpu_overhead": cpu_overhead,
        "in_bounds": equal and equal_after and overhead <= MOST_OVERHEAD,
    }


def _time(run: Runner, jobs: Sequence[ArmJob]) -> tuple[float, float]:
    """Measure the time of a run, and the processor time of this process and all that it has started."""
    began_s, began_cpu_s = time.perf_counter(), _cpu_s()
    measure_arms(run, jobs)
    return time.perf_counter() - began_s, _cpu_s() - began_cpu_s


def _cpu_s() -> float:
    """Add up the processor times of this process and its living descendants, as Linux counts them."""
    parent, ticks = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # a process has ended
            fields = path.read_text().rpartition(")")[2].split()
            parent[int(path.parent.name)] = int(fields[1])
            ticks[int(path.parent.name)] = int(fields[11]) + int(fields[12])

    def is_ours(process: int) -> bool:
        return process == os.getpid() or (process in parent and is_ours(parent[process]))

    return sum(ticks[process] for process in ticks if is_ours(process)) / os.sysconf("SC_CLK_TCK")


def measure_cost(count: int, seed: int) -> Document:
    """Measure the processor time of an arm in this process, and extrapolate it."""
    found = {}
    for model in ("statics", "closed-loop"):
        jobs = list_arms(count + 1, seed, model)
        run_job(jobs[0])  # what is loaded once does not count
        began = time.process_time()
        for job in jobs[1:]:
            run_job(job)
        arm_s = (time.process_time() - began) / count
        hours = {f"core_hours_of_{arms}": arm_s * arms / 3600 for arms in COST_ARMS}
        found[model] = {"arms": count, "cpu_s_of_an_arm": arm_s, **hours}
    return found


def campaign(context: Context, arms: int = 200, pairs: int = 25, cost: int = 20) -> Document:
    """Compare two nodes with one process.

    Args:
        context: Gives the seed.
        arms: Arms of each run.
        pairs: Pairs of times.
        cost: Arms of each kind, to measure the cost.
    """
    if min(arms, pairs, cost) < 1:
        raise BadRequest("set: arms, pairs and cost are 1 or more")
    found = compare(list_arms(arms, context.seed), pairs)
    return {**found, "cost": measure_cost(cost, context.seed)}

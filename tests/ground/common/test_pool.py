"""Tests of the runners on many cores and on a cluster."""

import os
import sys
from types import SimpleNamespace

import pytest

from ground.common.errors import BadRequest
from ground.common.pool import cluster_runner, local_runner


def square(x: int) -> int:
    return x * x


@pytest.mark.parametrize("workers", [1, 2])
def test_every_job_is_done_once(workers):
    assert sorted(local_runner(workers)(square, range(7))) == [0, 1, 4, 9, 16, 25, 36]


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
        cluster_runner()


def test_on_a_cluster_results_come_as_they_are_done(monkeypatch):
    """Check the calls of ray and their order; no cluster is available in tests."""
    started = []
    ray = SimpleNamespace(
        init=lambda **options: started.append(options),
        remote=lambda work: SimpleNamespace(remote=lambda job: (work, job)),
        wait=lambda waiting: (waiting[-1:], waiting[:-1]),
        get=lambda done: [work(job) for work, job in done],
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    assert list(cluster_runner()(square, [1, 2, 3])) == [9, 4, 1]
    assert len(started) == 1

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from mimic.errors import ConfigError, MissingExtra
from mimic.jobs.local import Died
from mimic.jobs.ray import results_on_ray


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of two nodes on this computer."""
    pytest.importorskip("ray", reason="playing on a cluster needs the extra 'ray'")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    from ray.cluster_utils import Cluster

    small = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
    nodes = Cluster(initialize_head=True, head_node_args={**small, "include_dashboard": False})
    try:
        nodes.add_node(**small)
        yield nodes.address
    finally:
        nodes.shutdown()


def where(job: float) -> tuple[float, str]:
    """Return the job and the node it ran on; wait so that both nodes get one."""
    import time

    import ray

    time.sleep(1.0)
    return job, ray.get_runtime_context().get_node_id()


def may_die(job: int) -> int:
    if job == 1:
        os._exit(7)
    return job


def test_jobs_run_on_both_nodes_and_give_their_own_results(cluster):
    results = dict(results_on_ray(where, [0.5, 1.5, 2.5, 3.5], address=cluster))
    assert {i: job for i, (job, _) in results.items()} == {0: 0.5, 1: 1.5, 2: 2.5, 3: 3.5}
    assert len({node for _, node in results.values()}) == 2


def test_a_job_that_takes_its_process_down_does_not_stop_the_rest(cluster):
    results = dict(results_on_ray(may_die, [0, 1, 2], address=cluster))
    assert isinstance(results.pop(1), Died)
    assert results == {0: 0, 2: 2}


def test_a_missing_cluster_is_reported_with_the_next_step(monkeypatch):
    ray = pytest.importorskip("ray", reason="playing on a cluster needs the extra 'ray'")

    def refuses(**options: object) -> None:
        raise ConnectionError("Failed to connect\nand much more")

    monkeypatch.setattr(ray, "init", refuses)
    with pytest.raises(ConfigError, match=r"10\.0\.0\.5:6379 \(Failed to connect\); start one with: ray start --head"):
        next(results_on_ray(where, [0.0], address="10.0.0.5:6379"))


def test_without_ray_the_extra_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtra, match="which is not installed: pip install 'ray"):
        next(results_on_ray(where, [0.0], address="auto"))

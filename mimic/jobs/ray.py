"""The same jobs on an existing Ray cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Sequence
from typing import Any

from mimic.errors import ConfigError, MissingExtra
from mimic.jobs.local import Died


def results_on_ray(play: Callable[[Any], Any], jobs: Sequence[Any], *, address: str) -> Generator[tuple[int, Any]]:
    """Yield index and result of each job as it ends, on the nodes of a cluster.

    Each node needs the same version of mimic and the same paths. A job takes one core. Jobs that still run when the
    iterator is closed, or when an exception passes, are ended.

    Args:
        play: A function that the nodes can import; it should not raise.
        jobs: Its arguments, one a call.
        address: Of the cluster, such as ``10.0.0.5:6379``, ``ray://10.0.0.5:10001`` or ``auto``.

    Raises:
        MissingExtra: If Ray is not installed.
        ConfigError: If there is no cluster at the address.
    """
    try:
        import ray
        from ray.exceptions import RayError
    except ModuleNotFoundError as missing:
        raise MissingExtra(str(missing.name), "ray") from None
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (ConnectionError, ValueError, RuntimeError, RayError) as error:
        reason = str(error).strip().split("\n")[0]
        raise ConfigError(
            f"there is no Ray cluster at {address} ({reason}); start one with: ray start --head"
        ) from None
    left: list[Any] = []
    try:
        remote = ray.remote(num_cpus=1, max_retries=0)(play)
        left = [remote.remote(job) for job in jobs]
        index = {task: i for i, task in enumerate(left)}
        while left:
            (done,), left = ray.wait(left, num_returns=1)
            try:
                result = ray.get(done)
            except RayError as error:
                result = Died(str(error).strip().split("\n")[0])
            yield index[done], result
    finally:
        for task in left:
            ray.cancel(task, force=True)
        ray.shutdown()

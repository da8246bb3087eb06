"""The computers of a Ray cluster as an engine (extra ``cluster``)."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Iterator
from typing import Any

from edmsim.errors import InputError
from edmsim.sweep.engine import ATTEMPTS, Function, Lost

IN_FLIGHT = 2
"""Jobs handed out per processor (ours): one that runs, and one that waits there while the answer travels."""
LOOK_S = 2.0
"""How often, at least, it is looked how many processors there are."""


class Cluster:
    """The processors of a Ray cluster, a job on each.

    Every computer needs this version of edmsim, and the files that runs name (programs, own constants and
    controllers) at the same paths: a shared folder, or Ray's own working directory. Answers travel to this process,
    which alone writes.

    Parameters
    ----------
    address : str
        ``"auto"`` for the cluster this computer belongs to, or ``HOST:PORT`` of one.

    Raises
    ------
    InputError
        Ray is not installed, or there is no such cluster.
    """

    def __init__(self, address: str = "auto") -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is told to anyone without being asked
        # Ray will change who hides the GPUs; runs use none
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        try:
            import ray
        except ImportError as error:
            raise InputError(f"a cluster needs {error.name}: pip install 'edmsim[cluster]'") from None
        self._ray: Any = ray
        if not ray.is_initialized():
            try:
                host = address.rpartition(":")[0]
                # of a cluster within one computer Ray would ask at the address other computers know it by
                here: dict[str, Any] = {"_node_ip_address": host} if host.startswith("127.") else {}
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **here)
            except (ConnectionError, ValueError, RuntimeError) as error:
                reason = str(error).split(". ")[0]
                raise InputError(f"there is no Ray cluster at '{address}' ({reason}); start one: ray start") from None

    @property
    def count(self) -> int:
        """Processors of the cluster as it is now."""
        return max(int(self._ray.cluster_resources().get("CPU", 0)), 1)

    def done(self, function: Function, jobs: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        """See `Engine.done`; jobs of a computer that is lost are begun again on another."""
        ray = self._ray
        remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1, scheduling_strategy="SPREAD")(function)
        waiting = iter(jobs)
        out: dict[Any, Any] = {}
        more = True
        try:
            while True:
                while more and len(out) < IN_FLIGHT * self.count:
                    try:
                        job = next(waiting)
                    except StopIteration:
                        more = False
                    else:
                        out[remote.remote(job)] = job
                if not out:
                    return
                ready, _ = ray.wait(list(out), num_returns=1, timeout=LOOK_S)
                for reference in ready:
                    yield out.pop(reference), self._answer(reference)
        finally:
            for reference in out:
                ray.cancel(reference, force=True)

    def _answer(self, reference: Any) -> Any:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            return Lost(str(error).strip().split("\n")[0] or type(error).__name__)


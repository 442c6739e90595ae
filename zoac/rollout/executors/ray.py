"""`executor=ray`: groups of environments as Ray actors, on one machine or many.

Ray restarts an actor that died, wherever there is room, and repeats the call that it died in.
This module restores the environments of a restarted actor.
"""

import os
import time
from typing import Any

from zoac.core.errors import ConfigError, WorkerError
from zoac.core.types import Count
from zoac.rollout.executors.pool import ATTEMPTS, Handle, Pool
from zoac.rollout.executors.worker import Worker, answered
from zoac.rollout.task import Task

try:
    import ray
except ImportError as error:
    raise ConfigError("executor=ray needs Ray: pip install 'zoac[ray]'") from error


class Ray(Pool):
    """Groups of neighbouring environments, each in an actor of its own."""

    def __init__(
        self,
        *,
        workers: Count | None = None,
        address: str | None = None,
    ) -> None:
        """
        Args:
            workers: Number of actors; None: one a core of the cluster.
            address: Of a running cluster, as `ray.init` takes it; None: that of RAY_ADDRESS, else
                a Ray of its own on this machine.
        """
        super().__init__(workers=workers)
        self._address = address
        self._mine = False

    def start(self, task: Task, num_envs: int, seed: int) -> None:
        """See `Pool.start`.

        Raises:
            ConfigError: If there is no cluster at `address`, or it has too few cores.
        """
        self._connect()
        cores = ray.cluster_resources().get("CPU", 0.0)
        workers = min(num_envs, self._count or self._cores())
        if workers > cores:
            raise ConfigError(
                f"executor.workers={workers} actors need {workers} cores; the Ray cluster has "
                f"{cores:g}"
            )
        # Shipped once, not once an actor; kept here, for a restart needs it again.
        self._task = ray.put(task)
        super().start(task, num_envs, seed)

    def _cores(self) -> int:
        return max(1, int(ray.cluster_resources().get("CPU", 0.0)))

    def _connect(self) -> None:
        """Use the Ray that this process is connected to already, or connect."""
        if ray.is_initialized():
            return
        try:
            ray.init(
                address=self._address,
                include_dashboard=None if self._address or "RAY_ADDRESS" in os.environ else False,
                log_to_driver=False,  # what actors print; the run's own lines stay readable
                logging_level="warning",
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ConfigError(
                f"executor.address={self._address!r}: no Ray cluster can be reached there: {error}"
            ) from error
        self._mine = True

    def _worker(self, task: Task, env_indices: list[int], seed: int) -> Handle:
        return _ActorHandle(self._task, env_indices, seed)

    def close(self) -> None:
        super().close()
        if self._mine:
            ray.shutdown()


@ray.remote
class _Actor:
    """A worker that notices when it has been restarted between two requests, or within one."""

    def __init__(self, task: Task, env_indices: list[int], seed: int) -> None:
        self._made_of = (task, env_indices, seed)
        self._worker = Worker()
        self._worker.start(*self._made_of)
        self._done = 0

    def answer(self, number: int, states: bytes | None, method: str, arguments: Any) -> Any:
        """Return (result, error, processor seconds, process id) of request `number`.

        Args:
            number: How many requests came before.
            states: Where the environments stand before this request; None: at their very beginning.
            method: Of `Worker`.
            arguments: For it.
        """
        if self._done != number:
            # Ray has restarted this actor, or repeats a call whose reply was lost.
            self._worker.start(*self._made_of)
            if states is not None:
                _, error = answered(self._worker.restore, (states,))
                if error is not None:
                    return None, error, time.process_time(), os.getpid()
        result, error = answered(getattr(self._worker, method), arguments)
        self._done = number + 1
        return result, error, time.process_time(), os.getpid()


class _ActorHandle(Handle):
    """This side of one actor."""

    def __init__(self, task: Any, env_indices: list[int], seed: int) -> None:
        super().__init__(env_indices)
        self._actor = _Actor.options(  # type: ignore[attr-defined]
            num_cpus=1, max_restarts=-1, max_task_retries=ATTEMPTS - 1
        ).remote(task, env_indices, seed)
        self._number = 0
        self._seconds: dict[int, float] = {}  # by process

    def ready(self) -> None:
        """See `Handle.ready`; Ray queues requests until the actor is there."""

    def begin(self, method: str, *arguments: Any) -> None:
        self._reply = self._actor.answer.remote(self._number, self.env_states, method, arguments)
        self._number += 1

    def finish(self) -> Any:
        try:
            result, error, seconds, process = ray.get(self._reply)
        except ray.exceptions.RayActorError as death:
            reason = str(death).strip().splitlines()[0]
            raise WorkerError(
                f"the Ray actor of {self} died {ATTEMPTS} times on the same work ({reason}). "
                "Memory may be short: try fewer environments"
            ) from None
        self._seconds[process] = seconds
        if error is not None:
            raise error
        return result

    @property
    def processor_seconds(self) -> float:
        return sum(self._seconds.values())

    def close(self) -> None:
        ray.kill(self._actor)

"""A study's runs as tasks on a Ray cluster, each with one CPU, retried elsewhere if its node is lost."""

import os
from collections.abc import Generator, Sequence
from typing import Any

import grpc

from corridor_server.shared.addresses import parse_address
from trainer.errors import TrainerError
from trainer.studies.executors import Attempt, RunOutcome, Task, Update
from trainer.studies.store import Store

RETRIES = 5
CONNECT_SECONDS = 5.0


class RayExecutor:
    """Tasks on a Ray cluster whose nodes have this package, and write to one results place.

    Args:
        address: ``HOST:PORT`` of the cluster's head, or ``auto`` for the one that runs here; None starts one here.
    """

    def __init__(self, address: str | None) -> None:
        self.address = address

    def check(self) -> None:
        """Connects to the cluster.

        Raises:
            TrainerError: Ray is not installed, or nobody answers.
        """
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
        except ImportError as error:
            raise TrainerError("--executor ray needs Ray; run 'pip install .[ray]'.") from error
        if self.address not in (None, "auto"):
            self._check_reachable(str(self.address))
        try:
            ray.init(self.address or "local", log_to_driver=False, logging_level="ERROR", include_dashboard=None)
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise TrainerError(
                f"There is no Ray cluster at --address {self.address} ({str(error).splitlines()[0]}); start one with "
                "'ray start --head', or leave --address out."
            ) from error

    def run(self, tasks: Sequence[Task]) -> Generator[Update, None, None]:
        """Submits them all; Ray runs as many at a time as the cluster has CPUs."""
        import ray

        remote = ray.remote(num_cpus=1, max_retries=RETRIES)(_execute)
        waiting = {remote.options(name=task.config.run_id).remote(task): task for task in tasks}
        try:
            while waiting:
                done, _ = ray.wait(list(waiting), timeout=1.0)
                ended = tuple(_outcome(reference, waiting.pop(reference)) for reference in done)
                busy = ray.cluster_resources().get("CPU", 0.0) - ray.available_resources().get("CPU", 0.0)
                yield Update(min(round(busy), len(waiting)), 0, ended)
        finally:
            for reference in waiting:
                ray.cancel(reference, force=True)
            ray.shutdown()

    def _check_reachable(self, address: str) -> None:
        """Ray itself would try for minutes."""
        try:
            if parse_address(address.removeprefix("ray://")) is None:
                raise ValueError("HOST:PORT, ray://HOST:PORT or auto was expected.")
        except ValueError as error:
            raise TrainerError(f"--address {address} is no Ray cluster's: {error}") from error
        channel = grpc.insecure_channel(address.removeprefix("ray://"))
        try:
            grpc.channel_ready_future(channel).result(CONNECT_SECONDS)
        except grpc.FutureTimeoutError as error:
            raise TrainerError(
                f"No Ray cluster answers at --address {address}; give the HOST:PORT that 'ray start --head' printed, "
                "or leave --address out to start a cluster here."
            ) from error
        finally:
            channel.close()


def _execute(task: Task) -> RunOutcome:
    store = Store(task.place)
    if (
        store.find(task.config, task.study, task.episodes) is not None
    ):  # published by an attempt whose node was lost just after
        return RunOutcome(task.config.run_id, None, task.place)
    attempt = Attempt(task)
    attempt.wait()
    return attempt.publish()


def _outcome(reference: Any, task: Task) -> RunOutcome:
    import ray

    config = task.config
    try:
        outcome: RunOutcome = ray.get(reference)
    except ray.exceptions.RayError as error:
        return RunOutcome(config.run_id, f"Ray gave it up: {' '.join(str(error).split())[:300]}", "Ray's, on its node")
    if outcome.error is None and Store(task.place).find(config, task.study, task.episodes) is None:
        return RunOutcome(
            config.run_id,
            f"its results did not arrive at {task.place}; the nodes need a shared folder, or a URL for --results-dir",
            outcome.log,
        )
    return outcome

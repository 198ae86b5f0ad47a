"""A training run with a clock in its parts: ``python -m trainer.bench.limit_program FOLDER STEPS PORT``.

It is a run of the default preset with curiosity. It writes what an update was spent in to FOLDER/parts.json.
"""

import json
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import CallbackList

from trainer.bench.limit_parts import CHECKPOINT, EXCHANGE, NETWORKS, OTHERS, STAGES, WAITING
from trainer.bench.peers.corridor_arrays import CorridorArrays
from trainer.bench.peers.corridor_slots import CorridorSlots
from trainer.config import ConnectionOptions, RunConfig
from trainer.learning.curiosity import Curiosity
from trainer.learning.icm import IntrinsicCuriosityModule
from trainer.learning.lean_actor_critic import LeanActorCritic
from trainer.learning.lean_ppo import LeanPPO
from trainer.learning.networks import Network
from trainer.learning.stages import build_stages
from trainer.players.communicator import ExchangeCommunicator
from trainer.players.environment import Environment
from trainer.players.several import Players
from trainer.presets import CURIOSITY_RATIO, preset_run
from trainer.runs.callbacks import Save
from trainer.runs.folder import RunFolder
from trainer.runs.run import train_run

# Updates: in one, products are written down; from the end of another on, time counts.
RECORDED, WARM_UP = 3, 5
SMALL_UPDATES = 60
LOOPS, REPEATS = 5, 200
# What is timed, and as what; of what is inside another, only the rest of the other counts there.
WRAPPED: tuple[tuple[type, str, str], ...] = (
    (LeanPPO, "train", NETWORKS),
    (LeanActorCritic, "act", NETWORKS),
    (LeanActorCritic, "values", NETWORKS),
    (LeanActorCritic, "noise", NETWORKS),
    (Curiosity, "learn", NETWORKS),
    (IntrinsicCuriosityModule, "intrinsic_reward", NETWORKS),
    (Environment, "send", EXCHANGE),
    (Environment, "receive", EXCHANGE),
    (ExchangeCommunicator, "receive", WAITING),
    (Save, "_save", CHECKPOINT),
    (CallbackList, "on_step", OTHERS),
    (CallbackList, "on_rollout_start", OTHERS),
    (CallbackList, "on_rollout_end", OTHERS),
    (Curiosity, "step_async", STAGES),
    (Curiosity, "step_wait", STAGES),
    (Players, "step_async", STAGES),
    (Players, "step_wait", STAGES),
)


class PartsClock:
    """Seconds by what they were spent in, whatever is timed inside another; all the rest is ``OTHERS``.

    Attributes:
        seconds: Since the last ``restart``.
    """

    def __init__(self) -> None:
        self._inside = [OTHERS]
        self.restart()

    def restart(self) -> None:
        """Begins anew, wherever the program is."""
        self.seconds: dict[str, float] = defaultdict(float)
        self._since = time.perf_counter()

    def look(self) -> None:
        """Counts the time until now."""
        now = time.perf_counter()
        self.seconds[self._inside[-1]] += now - self._since
        self._since = now

    def wrap(self, owner: type, name: str, part: str) -> None:
        """Has a method's time counted."""
        method = getattr(owner, name)

        def timed(*arguments: Any, **options: Any) -> Any:
            self.look()
            self._inside.append(part)
            try:
                return method(*arguments, **options)
            finally:
                self.look()
                self._inside.pop()

        setattr(owner, name, timed)


class RecordedArray(np.ndarray[Any, Any]):
    """An array that writes down the matrix products it is in, its transposes and parts too.

    Attributes:
        products: How often each was made, by the shapes and strides of both sides.
        operands: Arrays to make each again.
    """

    products: ClassVar[Counter[Any]] = Counter()
    operands: ClassVar[dict[Any, tuple[NDArray[Any], NDArray[Any]]]] = {}

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        plain = [each.view(np.ndarray) if isinstance(each, RecordedArray) else each for each in inputs]
        if "out" in options:
            options["out"] = tuple(each.view(np.ndarray) for each in options["out"])
        if ufunc is np.matmul:
            key = tuple((each.shape, each.strides) for each in plain)
            self.products[key] += 1
            self.operands.setdefault(key, (plain[0], plain[1]))
        return getattr(ufunc, method)(*plain, **options)


def record(networks: list[Network]) -> Callable[[], None]:
    """Has the networks' products written down; returns what ends that."""
    before = [(network, network.weights, network._weight_gradients) for network in networks]
    for network, weights, gradients in before:
        network.weights = [each.view(RecordedArray) for each in weights]
        network._weight_gradients = [each.view(RecordedArray) for each in gradients]

    def end() -> None:
        for network, weights, gradients in before:
            network.weights, network._weight_gradients = weights, gradients

    return end


def products_alone() -> float:
    """Seconds that the products take that were written down, each again and again and nothing else."""
    total = 0.0
    for key, count in RecordedArray.products.items():
        left, right = RecordedArray.operands[key]
        found = []
        for _ in range(LOOPS):
            begun = time.perf_counter()
            for _ in range(REPEATS):
                left @ right
            found.append((time.perf_counter() - begun) / REPEATS)
        total += count * float(np.median(found))
    return total


class MeasuredUpdates:
    """Notices where updates end, and what was spent in those that count.

    Args:
        clock: Of the parts.
    """

    def __init__(self, clock: PartsClock) -> None:
        self._clock = clock
        self._done = 0
        self._end_recording: Callable[[], None] | None = None
        self.seconds: dict[str, float] = {}
        self.updates = 0

    def follow(self) -> None:
        """Notices from here on."""
        train = LeanPPO.train

        def train_and_notice(model: LeanPPO) -> None:
            train(model)
            self._notice(model)

        setattr(LeanPPO, "train", train_and_notice)  # noqa: B010 - for mypy, a method is not to be assigned

    def _notice(self, model: LeanPPO) -> None:
        self._done += 1
        if self._end_recording is not None:
            self._end_recording()
            self._end_recording = None
        if self._done == RECORDED:
            self._end_recording = record(_networks(model))
        if self._done == WARM_UP:
            self._clock.restart()
        if self._done > WARM_UP:
            self._clock.look()
            self.updates = self._done - WARM_UP
            self.seconds = {name: total / self.updates for name, total in self._clock.seconds.items()}


def _networks(model: LeanPPO) -> list[Network]:
    networks = [model._networks.actor, model._networks.critic]
    stage: Any = model.get_env()
    while stage is not None and not isinstance(stage, Curiosity):
        stage = getattr(stage, "venv", None)
    if stage is not None and isinstance(stage.module, IntrinsicCuriosityModule):
        networks += [stage.module.encoder, stage.module.inverse_model, stage.module.forward_model]
    return networks


def small_updates(clock: PartsClock, config: RunConfig) -> float:
    """Seconds that networks take in an update of one area: as many calls, with hardly a number in them."""
    steps = config.ppo.n_steps
    model = build_stages(config, CorridorSlots(CorridorArrays(1, 0, {}, normalised=False))).model
    model.learn(WARM_UP * steps)
    clock.restart()
    model.learn(SMALL_UPDATES * steps, reset_num_timesteps=False)
    clock.look()
    return clock.seconds[NETWORKS] / SMALL_UPDATES


def main(folder: Path, steps: int, port: int) -> None:
    """Trains, measures, and writes."""
    config = preset_run("limit", "fast", c=CURIOSITY_RATIO, seed=0, steps=steps)
    clock = PartsClock()
    for owner, name, part in WRAPPED:
        clock.wrap(owner, name, part)
    measured = MeasuredUpdates(clock)
    measured.follow()
    with RunFolder.claim(config, folder, resume=False, force=False) as (results, draft):
        train_run(config, results, draft, ConnectionOptions(base_port=port), episodes=1)
    found = {"updates": measured.updates, "seconds": measured.seconds, "products": products_alone()}
    found["calls"] = small_updates(clock, replace(config, num_areas=1, steps=10**9))
    (folder / "parts.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))

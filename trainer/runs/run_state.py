"""Everything that decides how a run goes on, taken from its stages for a checkpoint and put back into them.

With the built-in player, whose areas are part of it, a resumed run does what the uncut one would have done, bit for
bit. With a player that can't write its areas down, new episodes begin; all the rest is as it was.
"""

import hashlib
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from trainer.errors import TrainerError
from trainer.learning.curiosity import Curiosity
from trainer.players.several import Players
from trainer.runs.checkpoint import Checkpoint

Windows = dict[str, deque[Any]]
Array = NDArray[Any]
# What SB3 records in an update and writes with the next row; everything else is recorded anew before each row.
UPDATE_TAGS = "train/"
MAY_BE_NAN = "train/explained_variance"  # of returns that are all the same


@dataclass
class Stages:
    """The environment's stages, lowest first, and the algorithm on top."""

    player: VecEnv
    normaliser: VecNormalize
    curiosity: Curiosity | None
    model: BaseAlgorithm


class RandomStates(NamedTuple):
    """Of the random streams that SB3 draws from: torch's, and NumPy's as ``np.random.get_state`` gives it."""

    torch: Array
    numpy: Any


def random_states() -> RandomStates:
    """Copies of the states as they are."""
    return RandomStates(torch.get_rng_state().numpy(), np.random.get_state(legacy=True))  # noqa: NPY002 - SB3's


def take(stages: Stages, windows: Windows, random: RandomStates, facts: Mapping[str, Any]) -> Checkpoint:
    """A run's state between two rollouts; the arrays are views.

    Args:
        stages: All of them; the next rollout's first actions may have been sent.
        windows: The last episodes' numbers.
        random: Of before those actions were drawn.
        facts: Further plain values.

    Raises:
        TrainerError: A loss is NaN or infinite.
    """
    model, statistics = stages.model, _statistics(stages.normaliser)
    _, keys, position, has_gauss, gauss = random.numpy
    arrays: dict[str, Array] = {
        "normaliser/mean": statistics.mean,
        "normaliser/var": statistics.var,
        "normaliser/count": np.array(statistics.count, np.float64),
        "random/torch": random.torch,
        "random/numpy": np.asarray(keys),
    }
    arrays |= {f"policy/{name}": each.numpy() for name, each in model.policy.state_dict().items()}
    arrays |= _optimizer(model)
    if stages.curiosity is not None:
        arrays |= {f"curiosity/{name}": each for name, each in stages.curiosity.state_dict().items()}
    monitor = _monitor(stages.normaliser)
    arrays |= {"monitor/returns": monitor.episode_returns, "monitor/lengths": monitor.episode_lengths}
    arrays |= {f"window/{name}": np.array(values) for name, values in windows.items()}
    for key in ("r", "l"):
        arrays[f"sb3_window/{key}"] = np.array([episode[key] for episode in model.ep_info_buffer or ()])
    arrays["sb3_window/success"] = np.array(list(model.ep_success_buffer or ()))
    arrays["last/observations"] = np.asarray(model._last_obs)
    arrays["last/starts"] = np.asarray(model._last_episode_starts)
    lives: list[int] = []
    if isinstance(stages.player, Players):
        lives = stages.player.lives
        arrays["player/observations"] = stages.player.observations
        for number, state in enumerate(stages.player.states() or ()):
            arrays[f"player_state/{number}"] = np.frombuffer(state, np.uint8)
    logged, excluded = model.logger.name_to_value, model.logger.name_to_excluded
    recorded = {tag: value for tag, value in logged.items() if tag.startswith(UPDATE_TAGS)}
    for tag, value in recorded.items():
        if not math.isfinite(value) and tag != MAY_BE_NAN:
            raise TrainerError(f"{tag} became {value}; the run has diverged: try a smaller learning rate.")
    return Checkpoint(
        {name: np.ascontiguousarray(each) if each.ndim else each for name, each in arrays.items()},
        {
            **facts,
            "env_steps": model.num_timesteps,
            "updates": getattr(model, "_n_updates", 0),
            "numpy_random": [position, has_gauss, gauss],
            "curiosity": None if stages.curiosity is None else stages.curiosity.facts(),
            "lives": lives,
            "logged": {tag: [_plain(value), list(excluded[tag] or ())] for tag, value in recorded.items()},
        },
    )


def load_policy(checkpoint: Checkpoint, stages: Stages, algo: str) -> None:
    """Puts the policy and the normaliser's statistics into freshly built stages.

    Raises:
        TrainerError: They are another algorithm's, or for other observations, actions or sizes.
    """
    theirs = checkpoint.facts["config"]["algo"]
    if theirs != algo:
        raise TrainerError(f"The checkpoint is of a run with --algo {theirs}, but this one has {algo}.")
    statistics, mean = _statistics(stages.normaliser), checkpoint.arrays["normaliser/mean"]
    if mean.shape != statistics.mean.shape:
        raise TrainerError(
            f"The checkpoint is for observations of {len(mean)} floats, but the player's have {len(statistics.mean)}."
        )
    policy = {name: torch.from_numpy(each.copy()) for name, each in checkpoint.part("policy").items()}
    try:
        stages.model.policy.load_state_dict(policy)
    except RuntimeError as error:
        raise TrainerError(f"The checkpoint is for other settings: {' '.join(str(error).split())[:300]}") from error
    statistics.mean, statistics.var = mean.copy(), checkpoint.arrays["normaliser/var"].copy()
    statistics.count = float(checkpoint.arrays["normaliser/count"])


def put_back(checkpoint: Checkpoint, stages: Stages, windows: Windows) -> bool:
    """Puts everything else of ``take`` into stages that ``load_policy`` has filled.

    Args:
        checkpoint: What ``take`` gave.
        stages: Built with the same settings, with players that were opened with the saved states.
        windows: Filled with what was saved.

    Returns:
        Whether the running episodes go on; otherwise new ones begin.

    Raises:
        TrainerError: The checkpoint is of another form.
    """
    model, facts = stages.model, checkpoint.facts
    try:
        _load_optimizer(model, checkpoint.part("optimizer"))
        if stages.curiosity is not None:
            stages.curiosity.load_state_dict(checkpoint.part("curiosity"), facts["curiosity"])
        for name, window in windows.items():
            window.extend(checkpoint.arrays[f"window/{name}"])
        lengths = checkpoint.arrays["sb3_window/l"]
        episodes = [{"r": r, "l": l} for r, l in zip(checkpoint.arrays["sb3_window/r"], lengths, strict=True)]  # noqa: E741
        size = model._stats_window_size
        model.ep_info_buffer = deque(episodes, size)
        model.ep_success_buffer = deque(checkpoint.arrays["sb3_window/success"], size)
        model.num_timesteps = facts["env_steps"]
        model._n_updates = facts["updates"]
        for tag, (value, excluded) in facts["logged"].items():
            model.logger.record(tag, math.nan if value is None else value, exclude=tuple(excluded) or None)
        torch.set_rng_state(torch.from_numpy(checkpoint.arrays["random/torch"].copy()))
        position, has_gauss, gauss = facts["numpy_random"]
        state = ("MT19937", checkpoint.arrays["random/numpy"], position, has_gauss, gauss)
        np.random.set_state(state)  # noqa: NPY002 - SB3's
        return _continue_episodes(checkpoint, stages)
    except (KeyError, ValueError, RuntimeError) as error:
        raise TrainerError(f"The checkpoint is for other settings: {' '.join(str(error).split())[:300]}") from error


def player_states(checkpoint: Checkpoint) -> list[bytes] | None:
    """What each player needs to go on where it was; None if a player could not say."""
    states = [checkpoint.arrays.get(f"player_state/{number}") for number in range(len(checkpoint.facts["lives"]))]
    known = [each.tobytes() for each in states if each is not None]
    return known if len(known) == len(states) else None


def policy_sha256(model: BaseAlgorithm) -> str:
    """SHA-256 over the policy's parameters: for each, in the order of their names, name and little-endian bytes."""
    digest = hashlib.sha256()
    for name, tensor in sorted(model.policy.state_dict().items()):
        array = tensor.numpy()
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


def _continue_episodes(checkpoint: Checkpoint, stages: Stages) -> bool:
    if not isinstance(stages.player, Players) or player_states(checkpoint) is None:
        return False
    shown = np.asarray(stages.player.reset())
    if not np.array_equal(shown, checkpoint.arrays["player/observations"]):
        return False  # another player, which does not know the side channel
    monitor = _monitor(stages.normaliser)
    monitor.episode_returns = checkpoint.arrays["monitor/returns"].copy()
    monitor.episode_lengths = checkpoint.arrays["monitor/lengths"].copy()
    observations = checkpoint.arrays["last/observations"]
    if stages.curiosity is not None:
        stages.curiosity.continue_from(observations, checkpoint.arrays["curiosity/episode_sums"])
    stages.model._last_obs = observations.copy()
    stages.model._last_episode_starts = checkpoint.arrays["last/starts"].copy()
    return True


def _plain(value: Any) -> int | float | None:
    """A logged number as JSON can have it: with the same digits, None for NaN."""
    if isinstance(value, int | np.integer):
        return int(value)
    return None if math.isnan(value) else float(str(value))


def _optimizer(model: BaseAlgorithm) -> dict[str, Array]:
    """Of a policy that has one optimiser: each kind of moment, and the step counts, of all parameters in one array."""
    optimizer = getattr(model.policy, "optimizer", None)
    if optimizer is None:
        return {}
    states = [optimizer.state[parameter] for parameter in _parameters(optimizer)]
    kinds = states[0] if states else {}
    return {
        f"optimizer/{kind}": np.concatenate([torch.as_tensor(state[kind]).numpy().ravel() for state in states])
        for kind in kinds
    }


def _load_optimizer(model: BaseAlgorithm, arrays: Mapping[str, Array]) -> None:
    optimizer = getattr(model.policy, "optimizer", None)
    if optimizer is None:
        return
    parameters = _parameters(optimizer)
    state: dict[int, dict[str, torch.Tensor]] = {index: {} for index in range(len(parameters))}
    for kind, array in arrays.items():
        whole = len(array) != len(parameters)  # else one number a parameter: how many steps were taken
        sizes = [parameter.numel() if whole else 1 for parameter in parameters]
        parts = torch.split(torch.from_numpy(array.copy()), sizes)
        for index, (parameter, part) in enumerate(zip(parameters, parts, strict=True)):
            state[index][kind] = part.reshape(parameter.shape if whole else ())
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state if arrays else {}})


def _parameters(optimizer: torch.optim.Optimizer) -> list[torch.Tensor]:
    return [parameter for group in optimizer.param_groups for parameter in group["params"]]


def _monitor(normaliser: VecNormalize) -> VecMonitor:
    assert isinstance(normaliser.venv, VecMonitor)
    return normaliser.venv


def _statistics(normaliser: VecNormalize) -> RunningMeanStd:
    assert isinstance(normaliser.obs_rms, RunningMeanStd)  # one vector observation
    return normaliser.obs_rms

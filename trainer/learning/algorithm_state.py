"""What a Stable-Baselines3 algorithm remembers, in parts that can be written down and taken up again.

This is where its private attributes are read and set: it has no public names for them.
"""

import hashlib
import math
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from trainer.errors import TrainerError

Array = NDArray[Any]
# What SB3 records in an update and writes with the next row; everything else is recorded anew before each row.
UPDATE_TAGS = "train/"
MAY_BE_NAN = "train/explained_variance"  # of returns that are all the same


class Policy:
    """The policy's parameters.

    Args:
        model: The algorithm.
    """

    def __init__(self, model: BaseAlgorithm) -> None:
        self._model = model

    def state_dict(self) -> dict[str, Array]:
        """The parameters by their names; views."""
        return {name: each.numpy() for name, each in self._model.policy.state_dict().items()}

    def load_state_dict(self, state: Mapping[str, Array]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            RuntimeError: The policy has other parameters.
        """
        self._model.policy.load_state_dict({name: torch.from_numpy(each.copy()) for name, each in state.items()})


class Optimizer:
    """The moments of a policy's optimiser, of all parameters in one array each; nothing for a policy without one.

    Args:
        model: The algorithm.
    """

    def __init__(self, model: BaseAlgorithm) -> None:
        self._optimizer: torch.optim.Optimizer | None = getattr(model.policy, "optimizer", None)

    def state_dict(self) -> dict[str, Array]:
        """Each kind of moment, and the step counts."""
        if self._optimizer is None:
            return {}
        parameters = self._parameters(self._optimizer)
        states: list[dict[str, Any]] = [self._optimizer.state[parameter] for parameter in parameters]
        stepped = next(filter(None, states), {})

        def numbers(kind: str, state: dict[str, Any], parameter: torch.Tensor) -> Array:
            if kind not in state:  # never stepped, as TRPO's actor, which would begin with zeros
                counts = torch.as_tensor(stepped[kind]).ndim == 0
                return np.zeros(1 if counts else parameter.numel(), np.float32)
            return torch.as_tensor(state[kind]).numpy().ravel()

        pairs = list(zip(states, parameters, strict=True))
        return {kind: np.concatenate([numbers(kind, *pair) for pair in pairs]) for kind in stepped}

    def load_state_dict(self, state: Mapping[str, Array]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            ValueError: The policy has other parameters.
        """
        if self._optimizer is None:
            return
        parameters = self._parameters(self._optimizer)
        moments: dict[int, dict[str, torch.Tensor]] = {index: {} for index in range(len(parameters))}
        for kind, array in state.items():
            whole = len(array) != len(parameters)  # else one number per parameter: how many steps were taken
            sizes = [parameter.numel() if whole else 1 for parameter in parameters]
            parts = torch.split(torch.from_numpy(array.copy()), sizes)
            for index, (parameter, part) in enumerate(zip(parameters, parts, strict=True)):
                moments[index][kind] = part.reshape(parameter.shape if whole else ())
        self._optimizer.load_state_dict({**self._optimizer.state_dict(), "state": moments if state else {}})

    @staticmethod
    def _parameters(optimizer: torch.optim.Optimizer) -> list[torch.Tensor]:
        return [parameter for group in optimizer.param_groups for parameter in group["params"]]


class Progress:
    """How far an algorithm has come: its counts, the last episodes, and what its last update recorded.

    Args:
        model: The algorithm.
    """

    def __init__(self, model: BaseAlgorithm) -> None:
        self._model = model

    def state_dict(self) -> dict[str, Any]:
        """``env_steps``, ``updates``, the window's ``r`` and ``l``, and ``logged``.

        Raises:
            TrainerError: A loss is NaN or infinite.
        """
        model = self._model
        values, excluded = model.logger.name_to_value, model.logger.name_to_excluded
        recorded = {tag: value for tag, value in values.items() if tag.startswith(UPDATE_TAGS)}
        for tag, value in recorded.items():
            if not math.isfinite(value) and tag != MAY_BE_NAN:
                raise TrainerError(f"{tag} became {value}; the run has diverged: try a smaller learning rate.")
        episodes = model.ep_info_buffer or ()
        return {
            "env_steps": model.num_timesteps,
            "updates": getattr(model, "_n_updates", 0),
            "r": np.array([episode["r"] for episode in episodes]),
            "l": np.array([episode["l"] for episode in episodes]),
            "logged": {tag: [_plain(value), list(excluded[tag] or ())] for tag, value in recorded.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
        """
        model = self._model
        episodes = [{"r": r, "l": length} for r, length in zip(state["r"], state["l"], strict=True)]
        model.ep_info_buffer = deque(episodes, model._stats_window_size)
        model.ep_success_buffer = deque(maxlen=model._stats_window_size)
        model.num_timesteps = state["env_steps"]
        model._n_updates = state["updates"]
        for tag, (value, excluded) in state["logged"].items():
            model.logger.record(tag, math.nan if value is None else value, exclude=tuple(excluded) or None)


class LastStep:
    """What an algorithm saw last, with which its next rollout begins.

    Args:
        model: The algorithm.
    """

    def __init__(self, model: BaseAlgorithm) -> None:
        self._model = model

    def state_dict(self) -> dict[str, Array]:
        """``observations``, (slots, ...), and ``starts``, (slots,): whether an episode begins with each."""
        return {
            "observations": np.asarray(self._model._last_obs),
            "starts": np.asarray(self._model._last_episode_starts),
        }

    def load_state_dict(self, state: Mapping[str, Array]) -> None:
        """Goes on in the middle of episodes.

        Raises:
            KeyError: Something is missing.
        """
        self._model._last_obs = state["observations"].copy()
        self._model._last_episode_starts = state["starts"].copy()


class RandomStreams:
    """The random streams that Stable-Baselines3 draws from: torch's, on a GPU too, and NumPy's; the process's own."""

    def __init__(self) -> None:
        self.note()

    def note(self) -> None:
        """Remembers the streams as they are now: what ``state_dict`` gives is of this moment."""
        self._torch = {"torch": torch.get_rng_state().numpy()}
        if torch.cuda.is_initialized():  # type: ignore[no-untyped-call]
            self._torch["cuda"] = torch.cuda.get_rng_state().numpy()
        self._numpy: Any = np.random.get_state(legacy=True)  # noqa: NPY002 - SB3's

    def state_dict(self) -> dict[str, Any]:
        """Theirs, by name.

        ``torch``; ``cuda`` where a GPU computes; ``numpy``, MT19937's key, and ``numpy_rest``, its position and the
        number that it has kept.
        """
        _, keys, *rest = self._numpy
        return {**self._torch, "numpy": np.asarray(keys), "numpy_rest": rest}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Sets these streams; a GPU's where there is one now and was one before.

        Raises:
            KeyError: Something is missing.
        """
        torch.set_rng_state(torch.from_numpy(state["torch"].copy()))
        if "cuda" in state and torch.cuda.is_initialized():  # type: ignore[no-untyped-call]
            torch.cuda.set_rng_state(torch.from_numpy(state["cuda"].copy()))
        np.random.set_state(("MT19937", state["numpy"], *state["numpy_rest"]))  # noqa: NPY002 - SB3's
        self.note()


def set_clock(model: BaseAlgorithm, seconds: float) -> None:
    """Has SB3 log these seconds since the run's first step: its own forgets earlier parts, and may be put back."""
    model.start_time = time.time_ns() - int(seconds * 1e9)
    model._num_timesteps_at_start = 0


def policy_sha256(model: BaseAlgorithm) -> str:
    """SHA-256 over a policy's parameters."""
    return weights_sha256(Policy(model).state_dict())


def weights_sha256(weights: Mapping[str, Array]) -> str:
    """SHA-256 over parameters: for each, in the order of their names, name and little-endian bytes."""
    digest = hashlib.sha256()
    for name, array in sorted(weights.items()):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


def _plain(value: Any) -> int | float | None:
    """A logged number as JSON can have it: with the same digits, None for NaN."""
    if isinstance(value, int | np.integer):
        return int(value)
    return None if math.isnan(value) else float(str(value))

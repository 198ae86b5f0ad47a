"""Adam's moments of every parameter, in a form that can be written down and taken up again."""

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


def adam_state(optimizer: torch.optim.Optimizer) -> dict[str, NDArray[Any]]:
    """Adam's moments of every parameter that has had a gradient, ``<kind>_<number>``."""
    state = {}
    for number, parameter in enumerate(_parameters(optimizer)):
        for kind, value in optimizer.state.get(parameter, {}).items():
            state[f"{kind}_{number}"] = value.cpu().numpy()
    return state


def load_adam_state(optimizer: torch.optim.Optimizer, state: Mapping[str, NDArray[Any]]) -> None:
    """Takes over what ``adam_state`` gave.

    Raises:
        KeyError: Something is missing.
    """
    for number, parameter in enumerate(_parameters(optimizer)):
        if f"step_{number}" in state:  # not of one that never had a gradient
            moments = {kind: torch.from_numpy(state[f"{kind}_{number}"].copy()) for kind in _MOMENTS}
            fused = optimizer.defaults["fused"]  # has its steps counted where the parameters are
            optimizer.state[parameter] = {
                kind: value if kind == "step" and not fused else value.to(parameter.device)
                for kind, value in moments.items()
            }


def _parameters(optimizer: torch.optim.Optimizer) -> Iterator[Tensor]:
    for group in optimizer.param_groups:
        yield from group["params"]

"""Steps of torch's Adam without torch's compiler, which its methods import to tell it that they are not to be compiled.

That is two seconds of every start, where nothing is compiled. An optimiser's numbers are the same either way.
"""

import inspect

import torch
from torch.optim import Adam, Optimizer

# Marked so, these methods are taken as they are.
for _method in vars(Optimizer).values():
    if _original := getattr(_method, "__wrapped__", None):
        _original.__dynamo_disable = _original
_step = inspect.unwrap(Adam.step)


@torch.no_grad()
def take_step(optimizer: Adam) -> None:
    """``optimizer.step()``."""
    _step(optimizer)

"""Adam in NumPy for parameters of torch: both see the same numbers."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from trainer.learning.networks import Adam, views


class TorchAdam(Adam):
    """Adam on a flat vector, of which torch's parameters become views, and an optimiser's moments once it steps.

    Args:
        parameters: On the CPU, float32; in this order.
    """

    def __init__(self, parameters: Sequence[nn.Parameter]) -> None:
        super().__init__(sum(each.numel() for each in parameters))
        self._theirs = list(parameters)
        self._shapes = [tuple(each.shape) for each in parameters]
        self._told_steps = torch.zeros(len(self._theirs))
        self._step_tensors = self._told_steps.unbind()  # views
        for parameter, view in zip(parameters, views(self.parameters, self._shapes), strict=True):
            view[...] = parameter.detach().numpy()
            parameter.data = torch.from_numpy(view)

    def step(self, optimizer: torch.optim.Optimizer) -> None:
        """Takes the step that an optimiser of the same parameters would take, with its settings."""
        self._bind(optimizer)
        group = optimizer.param_groups[0]
        self.descend(group["lr"], group["betas"], group["eps"])
        self._told_steps.fill_(self.steps)

    def limit(self, norm: float) -> None:
        """Scales the gradient down to a norm, as ``torch.nn.utils.clip_grad_norm_`` does."""
        found = float(np.sqrt(self.gradient @ self.gradient))
        if found + 1e-6 > norm:
            self.gradient *= np.float32(norm / (found + 1e-6))

    def _bind(self, optimizer: torch.optim.Optimizer) -> None:
        """Makes its moments views of ours; takes over what it holds where that is not so, after a load say."""
        first = optimizer.state[self._theirs[0]]
        if first and first["step"] is self._step_tensors[0]:
            return
        moments, squares = views(self.moment, self._shapes), views(self.square, self._shapes)
        for parameter, step, moment, square in zip(self._theirs, self._step_tensors, moments, squares, strict=True):
            state = optimizer.state[parameter]
            moment[...] = state["exp_avg"].numpy() if state else 0.0
            square[...] = state["exp_avg_sq"].numpy() if state else 0.0
            self.steps = int(state["step"]) if state else 0
            state.update(step=step, exp_avg=torch.from_numpy(moment), exp_avg_sq=torch.from_numpy(square))

"""Arrays as torch has them."""

from collections.abc import Sequence
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

CPU = torch.device("cpu")


def tensors(arrays: Sequence[NDArray[Any]], device: torch.device = CPU) -> tuple[Tensor, ...]:
    """Arrays as torch has them there; on the CPU views."""
    return tuple(torch.from_numpy(each).to(device) for each in arrays)


def tensor(array: NDArray[Any] | None, device: torch.device = CPU) -> Tensor | None:
    """The same of one that may not be there."""
    return None if array is None else torch.from_numpy(array).to(device)

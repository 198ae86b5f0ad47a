"""Where networks compute."""

from typing import TYPE_CHECKING

from trainer.errors import TrainerError

if TYPE_CHECKING:
    import torch

    from corridor_server.protocol.agents import Behavior
    from trainer.behavior_settings import NetworkSettings

WORTH_UNITS = 512  # in a layer; smaller networks of vectors wait longer for a GPU than they compute


def check_device(device: str) -> None:
    """Refuses a device that PyTorch does not see.

    Args:
        device: ``auto``, ``cpu`` or ``cuda``.

    Raises:
        TrainerError: It sees none.
    """
    if device != "cuda":
        return
    import torch

    if not torch.cuda.is_available():
        raise TrainerError(f"--device is {device}, but PyTorch sees no GPU here; take auto or cpu.")


def device_for(asked: str, behavior: "Behavior", network: "NetworkSettings") -> "torch.device":
    """Where a behavior's networks compute.

    Args:
        asked: ``auto`` takes a GPU, where there is one, for pictures, buffers and large layers; else what it says.
        behavior: What its agents observe.
        network: Its size.
    """
    import torch

    worth = network.hidden_units >= WORTH_UNITS or any(len(each.shape) > 1 for each in behavior.sensors)
    if asked == "auto":
        asked = "cuda" if worth and torch.cuda.is_available() else "cpu"
    return torch.device(asked)

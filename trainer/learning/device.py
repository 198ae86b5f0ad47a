"""Where networks compute."""

from trainer.errors import TrainerError


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

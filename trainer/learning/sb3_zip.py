"""A policy's weights out of a Stable-Baselines3 ``.zip``, without unpickling anything in it."""

import io
import zipfile
import zlib
from pathlib import Path
from pickle import UnpicklingError
from typing import TYPE_CHECKING, Any

from trainer.errors import TrainerError

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

POLICY = "policy.pth"
LIMIT = 256 * 2**20  # bytes, unpacked


def read_sb3_policy(path: Path) -> dict[str, Any]:
    """The weights of a saved Stable-Baselines3 policy.

    Of the file only ``policy.pth`` is read, as tensors (``weights_only``). What else it holds, settings and optimiser,
    is pickled and stays unread.

    Args:
        path: What ``model.save()`` of Stable-Baselines3 wrote.

    Raises:
        TrainerError: It is no such file, or holds anything but numbers.
    """
    try:
        with zipfile.ZipFile(path) as file:
            if file.getinfo(POLICY).file_size > LIMIT:
                raise TrainerError(f"{POLICY} in {path} has more than {LIMIT // 2**20} MiB; it is no policy of ours.")
            data = file.read(POLICY)
        import torch  # takes seconds, which a file that is none need not wait for

        weights: dict[str, Any] = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (
        OSError,
        LookupError,
        EOFError,
        RuntimeError,
        ValueError,
        zipfile.BadZipFile,
        zlib.error,
        UnpicklingError,
    ) as error:
        reason = " ".join(str(error).split())[:200]
        raise TrainerError(
            f"{path} is not a model that Stable-Baselines3 saved ({reason}); give what model.save() wrote."
        ) from error
    return weights


def load_sb3_policy(path: Path, model: "BaseAlgorithm") -> None:
    """Puts the weights of a saved Stable-Baselines3 policy into a model with the same networks.

    Raises:
        TrainerError: As ``read_sb3_policy``, or it is of another policy.
    """
    weights = read_sb3_policy(path)
    try:
        model.policy.load_state_dict(weights)
    except (RuntimeError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())[:300]
        raise TrainerError(f"{path} is of another policy than this run's: {reason}") from error
    for name, tensor in model.policy.state_dict().items():
        if not tensor.isfinite().all():
            raise TrainerError(f"{name} in {path} has numbers that are NaN or infinite; give an earlier save.")

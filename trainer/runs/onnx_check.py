"""Whether an ONNX graph does what the policy does that it was made of."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import onnx
import onnx.utils
from numpy.typing import NDArray
from onnx.reference import ReferenceEvaluator

from corridor_server.protocol.agents import VARIABLE_SIZE, Behavior
from trainer.errors import TrainerError
from trainer.learning.picture_encoder import channel_axis
from trainer.learning.transitions import Singles
from trainer.runs.onnx_graph import MASKS, Scaling

ACTION_TOLERANCE = 1e-5
LOG_PROB_TOLERANCE = 1e-4  # where two choices are as likely as each other, rounding decides
ROWS, ROWS_OF_PICTURES = 256, 8  # a convolution takes onnx's evaluator its time

Allowed = NDArray[np.bool_] | None
Choices = NDArray[np.int64]


class OwnPolicy(Protocol):
    """A policy on observations as they come: in the sensors' order, each (n, *shape) float32, not normalised.

    ``allowed`` is (n, all branches), True for what may be chosen; None if everything may.
    """

    def best(self, observations: Sequence[Singles], allowed: Allowed) -> tuple[Singles, Choices]:
        """The most likely actions: (n, continuous actions) as a player gets them, and (n, branches)."""

    def log_probs(self, observations: Sequence[Singles], allowed: Allowed, choices: Choices) -> Singles:
        """Of choices, (n,), but for a constant that is each row's own."""


def check_graph(program: bytes, behavior: Behavior, scalings: Mapping[int, Scaling], policy: OwnPolicy) -> None:
    """Compares a graph of ``graph_of`` with its policy on drawn observations and masks.

    Raises:
        TrainerError: The most likely actions differ, or one is a choice that is forbidden.
    """
    model = onnx.load_from_string(program)
    onnx.checker.check_model(model, full_check=True)
    generator = np.random.default_rng(0)
    observations = _drawn(behavior, scalings, generator)
    allowed = _drawn_masks(len(observations[0]), behavior.discrete_branches, generator)
    feed = {f"obs_{place}": _as_unity_has_it(behavior, place, each) for place, each in enumerate(observations)}
    if allowed is not None:
        feed[MASKS] = allowed.astype(np.float32)
    wanted = [each.name for each in model.graph.output if each.name.startswith("deterministic_")]
    part = onnx.utils.Extractor(model).extract_model(list(feed), wanted)
    outputs: list[Any] = list(ReferenceEvaluator(part).run(None, feed))
    found = dict(zip(wanted, outputs, strict=True))
    continuous, choices = policy.best(observations, allowed)
    if behavior.continuous_actions:
        _refuse(np.abs(found["deterministic_continuous_actions"] - continuous).max(), ACTION_TOLERANCE)
    if allowed is not None:
        chosen = found["deterministic_discrete_actions"]
        starts = np.cumsum((0, *behavior.discrete_branches[:-1]))
        if not np.take_along_axis(allowed, chosen + starts, axis=1).all():
            raise TrainerError("The exported policy makes choices that are masked; it was not written.")
        own, theirs = (policy.log_probs(observations, allowed, each) for each in (choices, chosen))
        _refuse(np.abs(own - theirs).max(), LOG_PROB_TOLERANCE)


def _refuse(difference: float, tolerance: float) -> None:
    if not difference <= tolerance:
        raise TrainerError(f"The exported policy differs from the run's by {difference:g}; it was not written.")


def _drawn(behavior: Behavior, scalings: Mapping[int, Scaling], generator: np.random.Generator) -> list[Singles]:
    """Observations of every kind that there is: vectors about their mean, pictures from 0 to 1, padded buffers."""
    pictures = [channel_axis(sensor) is not None for sensor in behavior.sensors]
    rows, drawn = ROWS_OF_PICTURES if any(pictures) else ROWS, []
    for place, sensor in enumerate(behavior.sensors):
        values = generator.standard_normal((rows, *sensor.shape))
        if pictures[place]:
            values = generator.random((rows, *sensor.shape))
        elif place in scalings:
            values[0] *= 100.0  # which the normalisation limits
            values = scalings[place].mean + scalings[place].deviation * values
        elif sensor.dimension_properties[:1] == (VARIABLE_SIZE,):
            values[np.arange(sensor.shape[0]) >= generator.integers(sensor.shape[0] + 1, size=(rows, 1))] = 0.0
        drawn.append(values.astype(np.float32))
    return drawn


def _drawn_masks(rows: int, branches: Sequence[int], generator: np.random.Generator) -> Allowed:
    """Masks that leave at least one choice in each branch."""
    if not branches:
        return None
    parts = []
    for size in branches:
        part = generator.random((rows, size)) < 0.5
        part[np.arange(rows), generator.integers(size, size=rows)] = True
        parts.append(part)
    return np.concatenate(parts, axis=1)


def _as_unity_has_it(behavior: Behavior, place: int, values: Singles) -> Singles:
    channel = channel_axis(behavior.sensors[place])
    return values if channel is None else np.moveaxis(values, channel + 1, 1)

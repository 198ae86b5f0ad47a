"""Compressed pictures of shape (channels, height, width), as Unity's package sends them from 3.0 on.

``mlagents_envs`` 0.28 decodes PNGs to (height, width, channels) and refuses every other shape. So a message that has
the newer one is shown to it with its shape turned, and what it decodes is turned back. Pictures as floats need nothing.
"""

from collections.abc import Mapping
from typing import Any

from mlagents_envs.base_env import BehaviorSpec

from corridor_server.protocol.messages import PNG

# A PNG begins with its signature and its header's length and name; then come width and height, big-endian.
_WIDTH, _HEIGHT = slice(16, 20), slice(20, 24)


def channels_last(
    agents: Mapping[str, Any], specs: dict[str, BehaviorSpec]
) -> tuple[dict[str, BehaviorSpec], list[tuple[str, int]]]:
    """Gives every compressed picture in a message the shape that ``mlagents_envs`` decodes it to.

    Args:
        agents: A message's ``agentInfos``; the pictures' shapes in it are changed.
        specs: The behaviors as the player announced them.

    Returns:
        The behaviors with those shapes, and which observations were turned: (behavior, index) each.
    """
    turned = [
        (behavior, index)
        for behavior, spec in specs.items()
        if behavior in agents and agents[behavior].value
        for index, observation in enumerate(agents[behavior].value[0].observations[: len(spec.observation_specs)])
        if _is_channels_first(observation)
    ]
    if not turned:
        return specs, turned
    for behavior, index in turned:
        for agent in agents[behavior].value:
            shape = agent.observations[index].shape
            shape[:] = _last(shape)
    return {name: _turned(spec, [at for of, at in turned if of == name]) for name, spec in specs.items()}, turned


def compressed_in(agents: Mapping[str, Any]) -> set[tuple[str, int]]:
    """Which observations in a message's ``agentInfos`` are compressed pictures: (behavior, index) each."""
    return {
        (behavior, index)
        for behavior, infos in agents.items()
        if infos.value
        for index, observation in enumerate(infos.value[0].observations)
        if observation.compression_type == PNG
    }


def _is_channels_first(observation: Any) -> bool:
    """Whether a compressed picture's height and width are the last two of its shape, and not the first two."""
    if observation.compression_type != PNG or len(observation.shape) != 3:
        return False
    data = observation.compressed_data
    size = [int.from_bytes(data[_HEIGHT], "big"), int.from_bytes(data[_WIDTH], "big")]
    return size == list(observation.shape[1:]) and size != list(observation.shape[:2])


def _last(shape: Any) -> tuple[int, int, int]:
    channels, height, width = shape
    return height, width, channels


def _turned(spec: BehaviorSpec, indices: list[int]) -> BehaviorSpec:
    observations = [
        each._replace(shape=_last(each.shape)) if index in indices else each
        for index, each in enumerate(spec.observation_specs)
    ]
    return spec._replace(observation_specs=observations)

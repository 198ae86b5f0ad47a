"""Convolutional networks for pictures, of ML-Agents' layers: what its setting ``vis_encode_type`` chooses from."""

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor, nn

from corridor_server.protocol.agents import NO_PROPERTY, TRANSLATIONAL_EQUIVARIANCE, Sensor
from trainer.errors import TrainerError

EncoderType = Literal["simple", "nature_cnn", "resnet", "match3", "fully_connected"]
# The shortest side of a picture that an encoder's layers take; "simple" takes any, with other layers below its 20.
SHORTEST_SIDES: dict[EncoderType, int] = {"nature_cnn": 36, "resnet": 15, "match3": 5}
SIMPLE_SIDE, SMALL_SIDE = 20, 5
RESNET_CHANNELS, BLOCKS = (16, 32, 32), 2


def channel_axis(sensor: Sensor) -> int | None:
    """Which dimension of a picture has its channels; None for a sensor that is no picture.

    It is the one dimension without a property beside two translation-equivariant ones, and the last one of a sensor of
    three dimensions that says nothing of them.
    """
    if len(sensor.shape) != 3:
        return None
    if not any(sensor.dimension_properties):
        return 2
    if sorted(sensor.dimension_properties) == [NO_PROPERTY] + [TRANSLATIONAL_EQUIVARIANCE] * 2:
        return sensor.dimension_properties.index(NO_PROPERTY)
    return None


class PictureEncoder(nn.Module):
    """Features of one picture: a convolutional network and a dense layer.

    ``simple`` fits any picture. From 20 x 20 its convolutions are ML-Agents' (16 kernels of 8 x 8 in steps of 4, 32 of
    4 x 4 in steps of 2). Below that, where these don't fit and where a cell often is a thing by itself, they are as
    many kernels of 3 x 3 in steps of 1; below 5 x 5 there is the dense layer alone. The others have ML-Agents' layers
    and its limits.

    Args:
        sensor: Of the picture, (height, width, channels) or (channels, height, width).
        units: How many features it has.
        vis_encode_type: Which network.

    Raises:
        TrainerError: The picture is too small for this network.
    """

    def __init__(self, sensor: Sensor, units: int, vis_encode_type: EncoderType) -> None:
        super().__init__()
        channel = channel_axis(sensor)
        assert channel is not None
        self._channel_dimension = channel + 1
        height, width = (size for axis, size in enumerate(sensor.shape) if axis != channel)
        shortest = SHORTEST_SIDES.get(vis_encode_type, 1)
        if min(height, width) < shortest:
            raise TrainerError(
                f"The picture {sensor.name} has {height} x {width} pixels, but vis_encode_type {vis_encode_type} takes "
                f"pictures from {shortest} x {shortest} on; choose simple, which takes any."
            )
        channels = sensor.shape[channel]
        convolutions = nn.Sequential(*_convolutions(vis_encode_type, channels, min(height, width)), nn.Flatten())
        with torch.no_grad():
            size = math.prod(convolutions(torch.zeros(1, channels, height, width)).shape)
        activation = nn.ReLU() if vis_encode_type == "resnet" else nn.LeakyReLU()
        self.layers = nn.Sequential(*convolutions, nn.Linear(size, units), activation)

    def forward(self, pictures: Tensor) -> Tensor:
        """Features, (n, units), of pictures of the sensor's shape, (n, *shape)."""
        features: Tensor = self.layers(pictures.movedim(self._channel_dimension, 1))
        return features


def _convolutions(vis_encode_type: EncoderType, channels: int, side: int) -> list[nn.Module]:
    if vis_encode_type == "resnet":
        return _residual(channels)
    if vis_encode_type == "nature_cnn":
        return _plain(channels, [(32, 8, 4), (64, 4, 2), (64, 3, 1)])
    if vis_encode_type == "match3":
        return _plain(channels, [(35, 3, 1), (144, 3, 1)])
    if vis_encode_type == "fully_connected" or side < SMALL_SIDE:
        return []
    return _plain(channels, [(16, 8, 4), (32, 4, 2)] if side >= SIMPLE_SIDE else [(16, 3, 1), (32, 3, 1)])


def _plain(channels: int, kernels: Sequence[tuple[int, int, int]]) -> list[nn.Module]:
    """Convolutions of so many kernels of such a size in such steps."""
    layers: list[nn.Module] = []
    for count, size, step in kernels:
        layers += [nn.Conv2d(channels, count, size, step), nn.LeakyReLU()]
        channels = count
    return layers


def _residual(channels: int) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for count in RESNET_CHANNELS:
        layers += [nn.Conv2d(channels, count, 3, padding=1), nn.MaxPool2d(3, 2)]
        layers += [_Residual(count) for _ in range(BLOCKS)]
        channels = count
    return [*layers, nn.SiLU()]


class _Residual(nn.Module):
    """Adds to its input what two convolutions make of it."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        first, second = (nn.Conv2d(channels, channels, 3, padding=1) for _ in range(2))
        self.layers = nn.Sequential(nn.SiLU(), first, nn.SiLU(), second)

    def forward(self, inputs: Tensor) -> Tensor:
        """The sum, of the input's shape."""
        added: Tensor = self.layers(inputs)
        return inputs + added

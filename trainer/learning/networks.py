"""Small networks in NumPy, over compiled kernels: on a CPU they take a fraction of torch's time.

Parameters, gradients and Adam's moments are flat vectors, so that a step of Adam is a handful of operations however
many layers there are; each layer's arrays are views of them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from trainer.learning.kernels import (
    Singles,
    adam_step,
    add_bias_swish,
    add_bias_tanh,
    to_before_swish,
    to_before_tanh,
)


class Adam:
    """Adam on a flat vector of parameters.

    Attributes:
        parameters: (size,).
        gradient: (size,), to be filled in before ``descend``.
        moment: (size,), the running mean of the gradient.
        square: (size,), the running mean of its square.
        factors: (size,), of each parameter on the learning rate.
        steps: How many steps were taken.
    """

    def __init__(self, size: int) -> None:
        self.parameters, self.gradient, self.moment, self.square = (np.zeros(size, np.float32) for _ in range(4))
        self.factors = np.ones(size, np.float32)
        self.steps = 0

    def descend(self, rate: float, betas: tuple[float, float] = (0.9, 0.999), epsilon: float = 1e-8) -> None:
        """Takes one step against the gradient, as ``torch.optim.Adam`` does."""
        self.steps += 1
        beta1, beta2 = betas
        adam_step(
            self.parameters,
            self.gradient,
            self.moment,
            self.square,
            self.factors,
            np.float32(rate / (1.0 - beta1**self.steps)),
            np.float32(1.0 - beta1),
            np.float32(beta2),
            np.float32(1.0 - beta2),
            np.float32(1.0 / math.sqrt(1.0 - beta2**self.steps)),
            np.float32(epsilon),
        )

    def state_dict(self) -> dict[str, Singles]:
        """Everything that it learns and remembers; the arrays are copies."""
        names = ("parameters", "moment", "square")
        return {**{name: getattr(self, name).copy() for name in names}, "steps": np.array([self.steps], np.float32)}

    def load_state_dict(self, state: Mapping[str, Singles]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: An array is missing.
            ValueError: An array is of another size.
        """
        for name in ("parameters", "moment", "square"):
            own: Singles = getattr(self, name)
            if state[name].shape != own.shape:
                raise ValueError(f"{name} has {state[name].size} numbers, but {own.size} were expected.")
            own[:] = state[name]
        self.steps = int(state["steps"][0])


class Activation(NamedTuple):
    """What a hidden layer does with its sums.

    Attributes:
        forward: Turns sums without their bias, (n, units), into what the layer gives, in place, given the bias,
            (units,); returns what ``backward`` needs, (n, units).
        backward: Turns d loss / d what the layer gave, (n, units), into d loss / d sum, in place, given what
            ``forward`` returned; fills in the total over n, (units,).
    """

    forward: Callable[[Singles, Singles], Singles]
    backward: Callable[[Singles, Singles, Singles], None]


def _tanh(values: Singles, bias: Singles) -> Singles:
    add_bias_tanh(values, bias)
    return values


def _swish(values: Singles, bias: Singles) -> Singles:
    bend = np.empty_like(values)
    add_bias_swish(values, bias, bend)
    return bend


TANH, SWISH = Activation(_tanh, to_before_tanh), Activation(_swish, to_before_swish)


class Passed(NamedTuple):
    """What is left of a batch that went through a network.

    Attributes:
        given: What each layer was given, (n, units before), the inputs first.
        kept: What each hidden layer's activation needs on the way back, (n, units).
    """

    given: list[Singles]
    kept: list[Singles]


class Network:
    """Hidden layers and a linear one.

    Args:
        sizes: Of an input, of each hidden layer, and of an output.
        activation: Of the hidden layers.

    Attributes:
        weights: Of each layer, (units, units before).
        biases: Of each layer, (units,).
    """

    def __init__(self, *sizes: int, activation: Activation = TANH) -> None:
        self._activation = activation
        self.shapes: list[tuple[int, ...]] = []
        for before, units in pairwise(sizes):
            self.shapes += [(units, before), (units,)]
        self.size = sum(math.prod(shape) for shape in self.shapes)
        self.weights, self.biases = list[Singles](), list[Singles]()
        self._weight_gradients, self._bias_gradients = list[Singles](), list[Singles]()

    def attach(self, parameters: Singles, gradient: Singles) -> None:
        """Makes the layers views of these vectors, each (size,)."""
        ours, slopes = views(parameters, self.shapes), views(gradient, self.shapes)
        self.weights, self.biases = ours[::2], ours[1::2]
        self._weight_gradients, self._bias_gradients = slopes[::2], slopes[1::2]

    def initialise(self, generator: np.random.Generator) -> None:
        """Draws weights and biases as ``torch.nn.Linear`` does: uniform within 1 / sqrt(inputs of the layer)."""
        for weight, bias in zip(self.weights, self.biases, strict=True):
            bound = 1.0 / math.sqrt(weight.shape[1])
            weight[...] = generator.uniform(-bound, bound, weight.shape)
            bias[...] = generator.uniform(-bound, bound, bias.shape)

    def __call__(self, inputs: Singles) -> tuple[Passed, Singles]:
        """What ``differentiate`` needs, and the output, (n, outputs)."""
        passed, last = Passed([inputs], []), len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values: Singles = passed.given[-1] @ weight.T
            if layer == last:
                values += bias
                return passed, values
            passed.kept.append(self._activation.forward(values, bias))
            passed.given.append(values)
        raise AssertionError("A network has a layer.")

    def differentiate(self, passed: Passed, slope: Singles) -> Singles:
        """Fills in the gradient.

        Args:
            passed: What the batch left.
            slope: d loss / d output, (n, outputs).

        Returns:
            d loss / d the first layer's sums, (n, its units).
        """
        given, kept = passed
        slope.sum(axis=0, out=self._bias_gradients[-1])
        for layer in range(len(given) - 1, 0, -1):
            np.matmul(slope.T, given[layer], out=self._weight_gradients[layer])
            slope = slope @ self.weights[layer]
            self._activation.backward(slope, kept[layer - 1], self._bias_gradients[layer - 1])
        np.matmul(slope.T, given[0], out=self._weight_gradients[0])
        return slope


def joined(networks: Sequence[Network], generator: np.random.Generator) -> Adam:
    """Puts networks on one vector of parameters, freshly drawn, and gives the Adam that learns it."""
    adam = Adam(sum(network.size for network in networks))
    start = 0
    for network in networks:
        part = slice(start, start + network.size)
        network.attach(adam.parameters[part], adam.gradient[part])
        network.initialise(generator)
        start += network.size
    return adam


def views(flat: Singles, shapes: Sequence[tuple[int, ...]]) -> list[Singles]:
    """Arrays of these shapes, one after another in a flat vector."""
    ends = np.cumsum([math.prod(shape) for shape in shapes])[:-1]
    return [part.reshape(shape) for part, shape in zip(np.split(flat, ends), shapes, strict=True)]

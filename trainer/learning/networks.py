"""Small networks in NumPy, whose float32 tanh and small products take a fraction of torch's time on a CPU.

Parameters, gradients and Adam's moments are flat vectors, so that a step of Adam is a handful of operations however
many layers there are; each layer's arrays are views of them.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]


class Adam:
    """Adam on a flat vector of parameters.

    Attributes:
        parameters: (size,).
        gradient: (size,), to be filled in before ``descend``.
        moment: (size,), the running mean of the gradient.
        square: (size,), the running mean of its square.
        steps: How many steps were taken.
    """

    def __init__(self, size: int) -> None:
        self.parameters, self.gradient, self.moment, self.square = (np.zeros(size, np.float32) for _ in range(4))
        self.steps = 0

    def descend(self, rate: float | Singles, betas: tuple[float, float] = (0.9, 0.999), epsilon: float = 1e-8) -> None:
        """Takes one step against the gradient, as ``torch.optim.Adam`` does, at one rate or each parameter's own."""
        self.steps += 1
        beta1, beta2 = betas
        self.moment += (self.gradient - self.moment) * np.float32(1.0 - beta1)
        self.square *= np.float32(beta2)
        self.square += np.square(self.gradient) * np.float32(1.0 - beta2)
        denominator = np.sqrt(self.square)
        denominator *= np.float32(1.0 / math.sqrt(1.0 - beta2**self.steps))
        denominator += np.float32(epsilon)
        self.parameters -= self.moment / denominator * np.asarray(rate / (1.0 - beta1**self.steps), np.float32)

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


class Network:
    """A hidden tanh layer and a linear one.

    Args:
        inputs: Length of an input.
        hidden: Units of the hidden layer.
        outputs: Length of an output.
    """

    def __init__(self, inputs: int, hidden: int, outputs: int) -> None:
        self.shapes = [(hidden, inputs), (hidden,), (outputs, hidden), (outputs,)]
        self.size = sum(math.prod(shape) for shape in self.shapes)

    def attach(self, parameters: Singles, gradient: Singles) -> None:
        """Makes the layers views of these vectors, each (size,)."""
        self.w1, self.b1, self.w2, self.b2 = _views(parameters, self.shapes)
        self._gw1, self._gb1, self._gw2, self._gb2 = _views(gradient, self.shapes)

    def initialise(self, generator: np.random.Generator) -> None:
        """Draws weights and biases as ``torch.nn.Linear`` does: uniform within 1 / sqrt(inputs of the layer)."""
        for weight, bias in ((self.w1, self.b1), (self.w2, self.b2)):
            bound = 1.0 / math.sqrt(weight.shape[1])
            weight[...] = generator.uniform(-bound, bound, weight.shape)
            bias[...] = generator.uniform(-bound, bound, bias.shape)

    def __call__(self, inputs: Singles) -> tuple[Singles, Singles]:
        """The hidden layer, (n, hidden), and the output, (n, outputs), of inputs, (n, inputs)."""
        hidden: Singles = inputs @ self.w1.T
        hidden += self.b1
        np.tanh(hidden, out=hidden)
        output: Singles = hidden @ self.w2.T
        output += self.b2
        return hidden, output

    def differentiate(self, inputs: Singles, hidden: Singles, slope: Singles) -> Singles:
        """Fills in the gradient for d loss / d output, (n, outputs); returns d loss / d hidden before its tanh."""
        np.matmul(slope.T, hidden, out=self._gw2)
        slope.sum(axis=0, out=self._gb2)
        back: Singles = slope @ self.w2
        back *= 1.0 - np.square(hidden)
        np.matmul(back.T, inputs, out=self._gw1)
        back.sum(axis=0, out=self._gb1)
        return back


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


def _views(flat: Singles, shapes: Sequence[tuple[int, ...]]) -> list[Singles]:
    ends = np.cumsum([math.prod(shape) for shape in shapes])[:-1]
    return [part.reshape(shape) for part, shape in zip(np.split(flat, ends), shapes, strict=True)]

"""Environment parameters that change between episodes: fixed values and samplers, drawn at each episode's start."""

import difflib
import math
from dataclasses import fields

import numpy as np

from corridor_server.corridor.arrays import Floats
from corridor_server.corridor.corridor_config import CorridorConfig, settable_parameters
from corridor_server.corridor.streams import Streams
from corridor_server.protocol.samplers import Gaussian, MultiRangeUniform, Uniform, Value
from corridor_server.shared.given import shown

SETTABLE = settable_parameters()


class EpisodeParameters:
    """The corridor's parameters for A areas: the config's, changed by what a trainer sets.

    ``columns`` maps each name to an (A,) float64 array, and is what ``world`` takes as its parameters; ``streams`` has
    the samplers' random streams. A change reaches an area when its next episode begins.
    """

    def __init__(self, config: CorridorConfig, areas: tuple[int, ...]) -> None:
        self.columns: dict[str, Floats] = {}
        for parameter in fields(config):
            value = getattr(config, parameter.name)
            if isinstance(value, tuple):
                self.columns[f"{parameter.name}_min"] = np.full(len(areas), value[0])
                self.columns[f"{parameter.name}_max"] = np.full(len(areas), value[1])
            else:
                self.columns[parameter.name] = np.full(len(areas), float(value))
        self.columns["decision_seconds"] = np.zeros(len(areas))
        self.columns["velocity_decay"] = np.zeros(len(areas))
        self._areas = areas
        self._values: dict[str, Value] = {}
        self._behind = np.zeros(len(areas), np.bool_)  # areas that have no episode yet with what was last set
        self.streams: dict[str, Streams] = {}
        for row in range(len(areas)):
            self._derive(row)

    def set(self, name: str, value: Value) -> bool:
        """Sets a parameter for every episode that begins from now on.

        Returns:
            Whether that changes anything.

        Raises:
            ValueError: The name is unknown, or a value that the sampler can give is out of range.
        """
        limits = SETTABLE.get(name)
        if limits is None:
            near = difflib.get_close_matches(name[:100], SETTABLE, n=1, cutoff=0.0)[0]
            low, high = SETTABLE[near]
            raise ValueError(
                f"{shown(name)} is not an environment parameter of the corridor; the nearest is {near}, {low:g} to "
                f"{high:g}."
            )
        low, high = limits
        if isinstance(value, Gaussian) and not 0.0 <= value.standard_deviation < math.inf:
            raise ValueError(f"{name} has st_dev {value.standard_deviation:g}, but a number from 0 up was expected.")
        for extreme in _extremes(value):
            if not low <= extreme <= high:  # also refuses NaN
                raise ValueError(f"{name} = {extreme:g} is out of its range, {low:g} to {high:g}.")
        if self._values.get(name) == value:
            return False
        self._values[name] = value
        self._behind[:] = True
        streams = dict(self.streams)
        if isinstance(value, float):
            streams.pop(name, None)
        else:
            streams[name] = Streams(value.seed, self._areas)
        # As if the values had been these from the beginning: what a saved state is taken up by.
        self.streams = {each: streams[each] for each in self._values if each in streams}
        return True

    def draw(self, row: int) -> None:
        """Gives the area in this row its parameters for a new episode."""
        if not self.streams and not self._behind[row]:
            return
        self._behind[row] = False
        for name, value in self._values.items():
            low, high = SETTABLE[name]
            drawn = value if isinstance(value, float) else value.sample(self.streams[name][row])
            drawn = min(max(drawn, low), high)  # only a Gaussian's tails leave the range
            for column in (name, f"{name}_min", f"{name}_max"):
                if column in self.columns:
                    self.columns[column][row] = drawn
        self._derive(row)

    def _derive(self, row: int) -> None:
        column = self.columns
        seconds = column["fixed_timestep"][row] * column["decision_period"][row]
        lag = column["agent_time_constant"][row]
        column["decision_seconds"][row] = seconds
        column["velocity_decay"][row] = math.exp(-seconds / lag) if lag > 0.0 else 0.0


def _extremes(value: Value) -> list[float]:
    match value:
        case Uniform():
            return [value.low, value.high]
        case Gaussian():
            return [value.mean]
        case MultiRangeUniform():
            return [end for pair in value.ranges for end in pair]
        case _:
            return [value]

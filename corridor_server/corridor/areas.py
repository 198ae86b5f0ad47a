"""Training areas side by side: who asks for a decision, who ended, with which reward."""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor import world
from corridor_server.corridor.arrays import Bools, Floats
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.drawing import top_view
from corridor_server.corridor.parameters import EpisodeParameters
from corridor_server.corridor.streams import Streams
from corridor_server.protocol.agents import ActionBatch, Agents, Behavior, Sensor
from corridor_server.protocol.samplers import Value
from corridor_server.simulations.simulation import Simulation

NAME = "Corridor"
BEHAVIOR = f"{NAME}?team=0"
Statistics = dict[str, Floats]


class Areas(Simulation):
    """Areas that share a config and a seed, each with its own random stream and agent, whose id is the area's number.

    Args:
        config: The corridor.
        seed: With an area's number, decides that area's episodes.
        areas: The areas' numbers; ``range(N)`` for N of them, ``[i]`` to look at the i-th alone.
        camera: Width and height of each agent's picture, in pixels; None draws none.

    Attributes:
        behaviors: What every area's agent is to a trainer, by its only behavior's name.
        parameters: What the next episodes will be like.
        state: Where everything is.
        restored: Whether a saved state was put back and has not moved since; resets keep it.
    """

    is_checked = True

    def __init__(
        self, config: CorridorConfig, seed: int, areas: Iterable[int], camera: tuple[int, int] | None = None
    ) -> None:
        numbers = tuple(areas)
        self.config = config
        size = config.observation_size
        sensors = [Sensor.of(f"VectorSensor_size{size}", (size,))]
        if camera is not None:  # sensors go by name, and C stands before V
            sensors.insert(0, Sensor.of("CameraSensor", (camera[1], camera[0], 3)))
        self._behaviors = {BEHAVIOR: Behavior(BEHAVIOR, tuple(sensors), world.ACTION_SIZE)}
        self.parameters = EpisodeParameters(config, numbers)
        self._streams = Streams(seed, numbers)
        self._camera = camera
        count = len(numbers)
        self.state = world.State.empty(count, config.num_opponents)
        self._ids = np.array(numbers, dtype=np.int32)
        # Areas whose running episode began by itself at the last one's end, and has not moved yet.
        self._begun_by_end = np.zeros(count, dtype=np.bool_)
        self.restored = False

    def __len__(self) -> int:
        return len(self._ids)

    @property
    def behaviors(self) -> Mapping[str, Behavior]:
        """The corridor's only one."""
        return self._behaviors

    def snapshot(self) -> NDArray[np.void]:
        """All that decides what happens from here on: episodes, parameters and random streams, a row per area."""
        columns: dict[str, NDArray[np.generic]] = {"id": self._ids, "stream": self._streams.words()}
        columns |= {each.name: getattr(self.state, each.name) for each in fields(self.state)}
        columns |= {f"parameter {name}": column for name, column in self.parameters.columns.items()}
        columns |= {f"sampler {name}": stream.words() for name, stream in self.parameters.streams.items()}
        rows = np.empty(len(self), [(name, column.dtype, column.shape[1:]) for name, column in columns.items()])
        for name, column in columns.items():
            rows[name] = column
        return rows

    def restore(self, rows: NDArray[np.void]) -> None:
        """Takes up what ``snapshot`` gave, in areas with the same config and samplers.

        The ids that stand there are not taken up: an agent's is its area's number, and once was its episode's.
        """
        self._streams.restore(rows["stream"])
        self.state = world.State(**{each.name: rows[each.name].copy() for each in fields(world.State)})
        for name, column in self.parameters.columns.items():
            column[:] = rows[f"parameter {name}"]
        for name, stream in self.parameters.streams.items():
            stream.restore(rows[f"sampler {name}"])
        self.restored = True

    def set_parameter(self, name: str, value: Value) -> None:
        """Sets an environment parameter for every episode that begins from now on (see ``EpisodeParameters.set``)."""
        if self.parameters.set(name, value):
            self._begun_by_end[:] = False

    def reset(self) -> dict[str, Agents]:
        """Starts a new episode in every area.

        An episode that began by itself when the last one ended and has not moved yet is kept: resetting after an end,
        as Gymnasium's loop does, must not skip an episode.

        Returns:
            Every area's agent, in area order.
        """
        if not self.restored:
            self._begin(np.flatnonzero(~self._begun_by_end))
        self._begun_by_end[:] = False
        return {BEHAVIOR: self._agents(np.zeros(len(self), dtype=np.float32))}

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[dict[str, Agents], Statistics]:
        """Applies one action per area, in area order, and begins the next episode wherever one ends.

        Returns:
            Agents whose episode ended, then every area's agent, both in area order: where an episode ended, with the
            next one's first observation. And ``world.statistics`` of the ended episodes by their names on the
            statistics channel, (ended,) each; nothing if none ended.
        """
        self.restored = False
        of_agents = actions[BEHAVIOR].continuous.astype(np.float64)
        self.state, outcome = world.step(self.parameters.columns, self.state, of_agents)
        agents = self._agents(outcome.reward.astype(np.float32))
        self._begun_by_end = outcome.ended
        rows = np.flatnonzero(outcome.ended)
        if not len(rows):
            return {BEHAVIOR: agents}, {}
        of_episodes = world.statistics(self.state, outcome)
        statistics = {f"{NAME}/{name}": values[rows] for name, values in of_episodes.items()}
        self._begin(rows)
        return {BEHAVIOR: self._with_ended(agents, rows, outcome.truncated)}, statistics

    def _agents(self, rewards: NDArray[np.float32]) -> Agents:
        return Agents.that_ask(self._ids.copy(), self._observed(), rewards)

    def _observed(self, rows: NDArray[np.intp] | None = None) -> tuple[NDArray[Any], ...]:
        """What the areas of these rows observe, or all of them."""
        vectors = world.observation(self.parameters.columns, self.state)
        if rows is not None:
            vectors = vectors[rows]
        if self._camera is None:
            return (vectors,)
        return self._pictures(np.arange(len(self)) if rows is None else rows), vectors

    def _with_ended(self, last: Agents, rows: NDArray[np.intp], truncated: Bools) -> Agents:
        """Puts the agents of ``rows``, as their episodes ended, before all agents, where their next ones begin."""
        seen = tuple(values[rows] for values in last.observations)
        ended = Agents.that_ended(self._ids[rows], seen, last.rewards[rows], truncated[rows])
        last.rewards[rows] = 0.0
        for values, first in zip(last.observations, self._observed(rows), strict=True):
            values[rows] = first
        return ended.then(last)

    def _pictures(self, areas: NDArray[np.intp]) -> NDArray[np.uint8]:
        assert self._camera is not None
        width, height = self._camera
        return np.stack([top_view(self.parameters.columns, self.state, area, width, height) for area in areas])

    def _begin(self, areas: NDArray[np.intp]) -> None:
        if not len(areas):
            return
        for area in areas:
            self.parameters.draw(int(area))
        p = {name: column[areas] for name, column in self.parameters.columns.items()}
        begun = world.initial(p, self.config.num_opponents, [self._streams[area] for area in areas])
        self.state = self.state.merged(areas, begun)

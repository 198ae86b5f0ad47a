"""Training areas side by side: who asks for a decision, who ended, under which id, with which reward."""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor import world
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.drawing import top_view
from corridor_server.corridor.parameters import EpisodeParameters
from corridor_server.corridor.streams import Streams
from corridor_server.protocol.samplers import Value


@dataclass(frozen=True)
class Agents:
    """Agents of one kind in a batch, in area order.

    Attributes:
        ids: (n,) int32, one id an episode.
        observations: (n, 8 + 5K) float32.
        rewards: Since the agent's last batch, (n,) float32.
        images: Top views, (n, height, width, 3) uint8; None without a camera.
    """

    ids: NDArray[np.int32]
    observations: NDArray[np.float32]
    rewards: NDArray[np.float32]
    images: NDArray[np.uint8] | None = None

    def rows(self, rows: NDArray[np.intp]) -> "Agents":
        """A copy of some of these agents."""
        images = None if self.images is None else self.images[rows]
        return Agents(self.ids[rows], self.observations[rows], self.rewards[rows], images)


@dataclass(frozen=True)
class Batch:
    """What the areas have to say after a reset or a decision.

    Attributes:
        deciding: Every area's agent that asks for an action; in an area whose episode just ended, the next one's.
        ended: Agents whose episode ended, with their last observation and reward.
        interrupted: Which of ``ended`` were cut by the step limit, (n,) bool.
        statistics: ``world.statistics`` of the ended episodes, (n,) each; empty if none ended.
    """

    deciding: Agents
    ended: Agents
    interrupted: NDArray[np.bool_]
    statistics: dict[str, world.Floats]


class Areas:
    """Areas that share a config and a seed, each with its own random stream and agent.

    Args:
        config: The corridor.
        seed: With an area's number, decides that area's episodes.
        areas: The areas' numbers; ``range(N)`` for N of them, ``[i]`` to look at the i-th alone.
        camera: Width and height of each agent's picture, in pixels; None draws none.
    """

    def __init__(
        self, config: CorridorConfig, seed: int, areas: Iterable[int], camera: tuple[int, int] | None = None
    ) -> None:
        numbers = tuple(areas)
        self.config = config
        self.parameters = EpisodeParameters(config, numbers)
        self._streams = Streams(seed, numbers)
        self._camera = camera
        self._next_id = 1
        count = len(numbers)
        self.state = world.State.empty(count, config.num_opponents)
        self._ids = np.zeros(count, dtype=np.int32)
        # Areas whose running episode began by itself at the last one's end, and has not moved yet.
        self._begun_by_end = np.zeros(count, dtype=np.bool_)
        self._restored = False

    def __len__(self) -> int:
        return len(self._ids)

    def snapshot(self) -> NDArray[np.void]:
        """All that decides what happens from here on: episodes, parameters and random streams, a row an area."""
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

        Resets keep the restored episodes until they have moved.
        """
        self._ids = rows["id"].copy()
        self._next_id = int(self._ids.max()) + 1  # the newest episode is always running
        self._streams.restore(rows["stream"])
        self.state = world.State(**{each.name: rows[each.name].copy() for each in fields(world.State)})
        for name, column in self.parameters.columns.items():
            column[:] = rows[f"parameter {name}"]
        for name, stream in self.parameters.streams.items():
            stream.restore(rows[f"sampler {name}"])
        self._restored = True

    def set_parameter(self, name: str, value: Value) -> None:
        """Sets an environment parameter for every episode that begins from now on (see ``EpisodeParameters.set``)."""
        if self.parameters.set(name, value):
            self._begun_by_end[:] = False

    def reset(self) -> Batch:
        """Starts a new episode in every area.

        An episode that began by itself when the last one ended and has not moved yet is kept: resetting after an end,
        as Gymnasium's loop does, must not skip an episode.
        """
        if not self._restored:
            self._begin(np.flatnonzero(~self._begun_by_end))
        self._begun_by_end[:] = False
        nobody = np.zeros(0, dtype=np.intp)
        deciding = self._agents(np.zeros(len(self), dtype=np.float32))
        return Batch(deciding, deciding.rows(nobody), np.zeros(0, dtype=np.bool_), {})

    def step(self, actions: NDArray[np.float32]) -> Batch:
        """Applies one action, (A, 2) in area order, and begins the next episode wherever one ends."""
        self._restored = False
        p = self.parameters.columns
        self.state, outcome = world.step(p, self.state, actions.astype(np.float64))
        agents = self._agents(outcome.reward.astype(np.float32))
        self._begun_by_end = outcome.ended
        rows = np.flatnonzero(outcome.ended)
        ended = agents.rows(rows)
        if not len(rows):
            return Batch(agents, ended, outcome.truncated[rows], {})
        statistics = {name: values[rows] for name, values in world.statistics(self.state, outcome).items()}
        self._begin(rows)
        agents.ids[rows] = self._ids[rows]
        agents.observations[rows] = world.observation(p, self.state)[rows]
        agents.rewards[rows] = 0.0
        if agents.images is not None:
            agents.images[rows] = self._pictures(rows)
        return Batch(agents, ended, outcome.truncated[rows], statistics)

    def _agents(self, rewards: NDArray[np.float32]) -> Agents:
        observations = world.observation(self.parameters.columns, self.state)
        images = None if self._camera is None else self._pictures(np.arange(len(self)))
        return Agents(self._ids.copy(), observations, rewards, images)

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
        self._ids[areas] = np.arange(self._next_id, self._next_id + len(areas))
        self._next_id += len(areas)

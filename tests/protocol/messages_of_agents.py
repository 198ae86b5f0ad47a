"""Messages with agents of any kind, as protobuf writes them, and what the parser makes of them."""

from typing import Any

import numpy as np

from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import Agents, Sensor
from corridor_server.protocol.messages import AgentInfoProto, UnityMessageProto

VECTOR = Sensor("VectorSensor_size13", (13,), (1,))
# Behaviors with their sensors and discrete branches.
KINDS: dict[str, tuple[tuple[Sensor, ...], tuple[int, ...]]] = {
    "Corridor?team=0": ((VECTOR,), ()),
    "Soccer?team=1": ((Sensor("Rays", (44,), (1,)), Sensor("Goal", (3,), (1,), 1), VECTOR), (3, 3, 3)),
    "Collector?team=0": ((Sensor("Buffer", (4, 5), (4, 1)),), (130,)),
    "Old": ((Sensor("", (2,), ()),), (2,)),
}
ROWS = {name: AgentRows(*kind) for name, kind in KINDS.items()}
IDS = np.array([0, 1, 127, 128, 2**14 - 1, 2**14, 2**21 - 1, 2**21, 2**28 - 1, 2**28, 2**31 - 1], np.int32)


def random_agents(rng: np.random.Generator, behavior: str, count: int) -> Agents:
    """Agents whose rows have any layout; often long runs of one."""
    sensors, branches = KINDS[behavior]
    plain = rng.random() < 0.5

    def sometimes(values: np.ndarray, share: float) -> np.ndarray:
        return np.where(rng.random(count) < share, values, np.zeros(1, values.dtype))

    done = rng.random(count) < (0.0 if plain else 0.3)
    rewards = rng.normal(size=count).astype(np.float32)
    numbers = np.where(rng.random(count) < 0.5, rng.choice(IDS, count), rng.integers(0, 300, count))
    in_order, rare = np.arange(count), rng.choice(np.array([-0.0, np.nan, np.inf, 1e-45], np.float32), count)
    share = 0.05 if plain else 0.3
    return Agents(
        (in_order if plain else numbers).astype(np.int32),
        sometimes(np.where(rng.random(count) < 0.05, rare, rewards), 1.0 if plain else 0.6),
        done,
        done & (rng.random(count) < 0.5),
        tuple(rng.normal(size=(count, *sensor.shape)).astype(np.float32) for sensor in sensors),
        sometimes(rng.choice(IDS, count), 0.0 if plain else share),
        sometimes(rewards[::-1].copy(), 0.0 if plain else share),
        tuple(rng.random((count, size)) < 0.3 for size in branches) if rng.random() < 0.7 else (),
    )


def message_of(batches: dict[str, Agents], side_channel: bytes = b"") -> bytes:
    """The message as protobuf writes it."""
    message = UnityMessageProto()
    message.header.status = 200
    rl_output = message.unity_output.rl_output
    rl_output.side_channel = side_channel
    for name, agents in batches.items():
        rl_output.agentInfos[name].value.extend(_info(agents, row, KINDS[name][0]) for row in range(len(agents)))
    return message.SerializeToString(deterministic=True)


def _info(agents: Agents, row: int, sensors: tuple[Sensor, ...]) -> Any:
    info = AgentInfoProto(
        id=int(agents.ids[row]),
        reward=agents.rewards[row],
        done=agents.done[row],
        max_step_reached=agents.interrupted[row],
        group_id=int(agents.group_ids[row]),
        group_reward=agents.group_rewards[row],
    )
    for mask in agents.masks:
        info.action_mask.extend(mask[row].tolist())
    for sensor, values in zip(sensors, agents.observations, strict=True):
        observation = info.observations.add(
            name=sensor.name,
            shape=sensor.shape,
            dimension_properties=sensor.dimension_properties,
            observation_type=sensor.kind,
        )
        observation.float_data.data.extend(values[row].ravel().tolist())
    return info


def parsed(data: bytes) -> tuple[dict[str, Agents], bytes]:
    """What protobuf's parser makes of a message."""
    rl_output = UnityMessageProto.FromString(data).unity_output.rl_output
    found = {name: _agents(rl_output.agentInfos[name].value, *KINDS[name]) for name in rl_output.agentInfos}
    return found, rl_output.side_channel


def _agents(infos: Any, sensors: tuple[Sensor, ...], branches: tuple[int, ...]) -> Agents:
    count, ends = len(infos), np.cumsum(branches, dtype=int)
    masks = np.zeros((count, sum(branches)), np.bool_)
    for row, info in enumerate(infos):
        if len(info.action_mask) == masks.shape[1]:  # others mean nothing to mlagents_envs
            masks[row] = info.action_mask
    floats = [[info.observations[number].float_data.data for info in infos] for number in range(len(sensors))]
    return Agents(
        np.array([info.id for info in infos], np.int32),
        np.array([info.reward for info in infos], np.float32),
        np.array([info.done for info in infos], np.bool_),
        np.array([info.max_step_reached for info in infos], np.bool_),
        tuple(
            np.array(rows, np.float32).reshape(count, *sensor.shape)
            for rows, sensor in zip(floats, sensors, strict=True)
        ),
        np.array([info.group_id for info in infos], np.int32),
        np.array([info.group_reward for info in infos], np.float32),
        tuple(masks[:, end - size : end] for size, end in zip(branches, ends, strict=True)),
    )


def same(one: Agents, other: Agents) -> bool:
    """Whether two batches are equal, with NaN equal to itself; no masks are as good as masks that forbid nothing."""
    columns = ("ids", "rewards", "done", "interrupted", "group_ids", "group_rewards")
    pairs = [(getattr(one, name), getattr(other, name)) for name in columns]
    pairs += zip(one.observations, other.observations, strict=True)
    if one.masks and other.masks:
        pairs += zip(one.masks, other.masks, strict=True)
    elif any(mask.any() for mask in (*one.masks, *other.masks)):
        return False
    return all(a.dtype == b.dtype and a.shape == b.shape and _bits(a) == _bits(b) for a, b in pairs)


def _bits(values: np.ndarray) -> bytes:
    """All NaNs alike: Python's floats don't keep every kind."""
    return np.where(np.isnan(values), np.full(1, np.nan, np.float32), values).tobytes()

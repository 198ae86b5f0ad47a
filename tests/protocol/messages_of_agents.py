"""Messages with agents of any kind, as protobuf writes them, what the parser makes of them, and ways to spoil one."""

from typing import Any

import numpy as np

from corridor_server.protocol.agent_rows import AgentRows
from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.protocol.messages import AgentInfoProto, UnityMessageProto
from corridor_server.protocol.wire_bytes import HEADER_OK

VECTOR = Sensor("VectorSensor_size13", (13,), (1,))
# Behaviors with their sensors and discrete branches.
KINDS: dict[str, tuple[tuple[Sensor, ...], tuple[int, ...]]] = {
    "Corridor?team=0": ((VECTOR,), ()),
    "Soccer?team=1": ((Sensor("Rays", (44,), (1,)), Sensor("Goal", (3,), (1,), 1), VECTOR), (3, 3, 3)),
    "Collector?team=0": ((Sensor("Buffer", (4, 5), (4, 1)),), (130,)),
    "Old": ((Sensor("", (2,), ()),), (2,)),
}
ROWS = {name: AgentRows(*kind) for name, kind in KINDS.items()}
# With two continuous actions where there are no discrete ones.
BEHAVIORS = {
    name: Behavior(name, sensors, 0 if branches else 2, branches) for name, (sensors, branches) in KINDS.items()
}
IDS = np.array([0, 1, 127, 128, 2**14 - 1, 2**14, 2**21 - 1, 2**21, 2**28 - 1, 2**28, 2**31 - 1], np.int32)
# What makes any message one that is left to the parser.
UNUSUAL = {
    "an unknown field after the message": lambda data: data + b"\xf8\x01\x07",
    "an unknown field before it": lambda data: b"\xf8\x01\x07" + data,
    "another status": lambda data: data.replace(b"\x08\xc8\x01", b"\x08\x90\x03", 1),
    "a second header": lambda data: data + HEADER_OK,
    "a byte cut off": lambda data: data[:-1],
    "nothing": lambda data: b"",
}


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


IS_TAG = np.isin(np.arange(256), list(b"\x0a\x3d\x40\x48\x50\x5a\x6a\x70\x7d"))  # of an agent's fields


def mutated(rng: np.random.Generator, data: bytes) -> bytes:
    """Some bytes changed, cut out, put in or repeated; often near a row's beginning, where its fields are."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        place = int(rng.integers(len(changed)))
        match rng.integers(5):
            case 0:
                changed[place] = int(rng.integers(256))
            case 1:
                changed[place] ^= 1 << int(rng.integers(8))
            case 2:
                (tags,) = IS_TAG[np.frombuffer(bytes(changed), np.uint8)].nonzero()
                near = int(tags[rng.integers(len(tags))] if len(tags) else place) + int(rng.integers(-1, 2))
                changed[min(max(near, 0), len(changed) - 1)] = b"\x00\x01\x02\x80\xff"[rng.integers(5)]
            case 3:
                del changed[place : place + int(rng.integers(1, 9))]
            case _:
                changed[place:place] = changed[place : place + int(rng.integers(1, 9))]
        if not changed:
            break
    return bytes(changed)

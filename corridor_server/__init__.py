"""The paper's corridor as a player that speaks the ML-Agents protocol, and as a Gymnasium environment.

The data flows one way: ``config`` -> ``world`` -> ``drawing``, ``areas`` -> ``wire``, ``side_channels`` -> ``player``.
``gym_env`` stands on ``areas`` too, and is the oracle that the player is tested against.
"""

from importlib.util import find_spec

if find_spec("gymnasium") is not None:  # the player runs without it
    from gymnasium.envs.registration import register

    register(id="Corridor-v0", entry_point="corridor_server.corridor.gym_env:CorridorEnv")

"""The paper's corridor as a player that speaks the ML-Agents protocol, and as a Gymnasium environment.

``protocol`` knows messages and agents, and no simulation; ``corridor`` is the simulation, and knows no message.
``player`` brings them together: ``corridor_config`` -> ``world`` -> ``areas`` -> agents -> ``wire`` -> ``connection``.
``corridor.gym_env`` is the same world in process, and the oracle that the player is tested against.
"""

from importlib.util import find_spec

if find_spec("gymnasium") is not None:  # the player runs without it
    from gymnasium.envs.registration import register

    register(id="Corridor-v0", entry_point="corridor_server.corridor.gym_env:CorridorEnv")

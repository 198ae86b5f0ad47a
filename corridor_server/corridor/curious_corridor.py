"""The corridor on which curiosity decides between failure and success (docs/calibration.md): what isn't the default.

The trainer's presets ask a player for it, by the environment-parameters side channel, and Gymnasium makes it as
``CuriousCorridor-v0``.
"""

import struct

Value = float | tuple[float, float]

CURIOUS: dict[str, Value] = {
    "agent_speed": 3.0,
    "agent_time_constant": 0.2,
    "agent_spawn_x": (-7.5, -5.5),
    "goal_x": 5.0,
    "goal_radius": 2.0,
    "opponent_speed": 1.5,
    "opponent_target_x": 1.0,
}


def as_environment_parameters() -> dict[str, float]:
    """The corridor's parameters as the side channel names them: a range has two ends."""
    told: dict[str, float] = {}
    for name, value in CURIOUS.items():
        ends = (("_min", value[0]), ("_max", value[1])) if isinstance(value, tuple) else (("", value),)
        told |= {f"{name}{end}": number for end, number in ends}
    return told


def as_a_player_has_it() -> dict[str, Value]:
    """Fields of ``CorridorConfig`` with the numbers that arrive at a player, which are float32."""
    return {
        name: (_float32(value[0]), _float32(value[1])) if isinstance(value, tuple) else _float32(value)
        for name, value in CURIOUS.items()
    }


def _float32(number: float) -> float:
    (rounded,) = struct.unpack("<f", struct.pack("<f", number))
    return float(rounded)

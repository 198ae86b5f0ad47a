"""How much ``corridor bench`` measures."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from trainer.presets import PRESETS


@dataclass(frozen=True)
class Workload:
    """How much is measured, and on what.

    Attributes:
        areas: In one player, for each row of the exchange's table.
        rounds: How often each rate is measured; the median counts.
        seconds: How long each measurement of a rate lasts.
        train_steps: Agent steps of a training run, by preset.
        train_rounds: How often each training run is made; the median counts.
        players: Pairs of players and areas in each, as many areas in all of them.
        peer_areas: Of the corridor that is trained on beside others.
        peer_seconds: How long each of these measurements lasts.
        limit_updates: Of the default preset, in which parts are timed.
        memory_areas: In the player whose memory is measured.
        memory_steps: Agent steps after which memory is measured, by the name that the report gives them.
    """

    areas: tuple[int, ...] = (1, 16, 64, 256, 1024, 4096)
    rounds: int = 5
    seconds: float = 0.6
    train_steps: Mapping[str, int] = field(default_factory=lambda: {"fast": 400_000, "paper": 20_000})
    train_rounds: int = 2
    players: tuple[tuple[int, int], ...] = ((1, 256), (4, 64))
    peer_areas: int = PRESETS["fast"].num_areas
    peer_seconds: float = 2.0
    limit_updates: int = 150
    memory_areas: int = 1024
    memory_steps: Mapping[str, int] = field(default_factory=lambda: {"1e6": 10**6, "1e7": 10**7})


FULL = Workload()

"""This trainer's PPO, with and without curiosity, on the corridor in process and on a player."""

from contextlib import ExitStack
from pathlib import Path

from stable_baselines3.common.vec_env import VecEnv

from trainer.bench.peers.corridor_arrays import CorridorArrays
from trainer.bench.peers.corridor_slots import CorridorSlots, TakeTurns
from trainer.bench.peers.peer_settings import PeerSettings
from trainer.config import ConnectionOptions, PresetName, RestartLimits
from trainer.learning.stages import build_stages
from trainer.players.failures import PlayerLogs
from trainer.players.opening import open_slots
from trainer.presets import preset_run
from trainer.signals import temporary_folder

FOR_EVER = 10**9
OURS: PresetName = "fast"  # the preset whose settings all programs are given


def main(settings: PeerSettings) -> None:
    """Learns in turns."""
    config = preset_run("peers", OURS, c=settings.c, seed=settings.seed, steps=FOR_EVER, num_areas=settings.areas)
    corridor = None
    with ExitStack() as stack:
        if settings.port is None:
            corridor = CorridorArrays(settings.areas, settings.seed, settings.corridor, normalised=False)
            slots: VecEnv = CorridorSlots(corridor)
        else:
            logs = PlayerLogs(Path(stack.enter_context(temporary_folder())))
            connection = ConnectionOptions(base_port=settings.port)
            opened = open_slots(config, logs, connection, seed=settings.seed, limits=RestartLimits())
            slots = stack.enter_context(opened)
        model = build_stages(config, slots).model
        model.learn(FOR_EVER, callback=TakeTurns(settings.warm_up, corridor), log_interval=FOR_EVER)


if __name__ == "__main__":
    main(PeerSettings.given())

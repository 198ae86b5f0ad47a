"""Stable-Baselines3's PPO."""

from stable_baselines3 import PPO

from trainer.bench.peers.corridor_slots import learn_as_sb3
from trainer.bench.peers.peer_settings import PeerSettings


def main(settings: PeerSettings) -> None:
    """Learns in turns."""
    learn_as_sb3(PPO, settings, clip_range_vf=settings.clip_range_vf, device="cpu")


if __name__ == "__main__":
    main(PeerSettings.given())

"""SBX: the PPO of Stable-Baselines3 in JAX. It does not clip values."""

from sbx import PPO

from trainer.bench.peers.corridor_slots import learn_as_sb3
from trainer.bench.peers.peer_settings import PeerSettings


def main(settings: PeerSettings) -> None:
    """Learns in turns."""
    learn_as_sb3(PPO, settings)


if __name__ == "__main__":
    main(PeerSettings.given())

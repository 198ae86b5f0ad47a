"""Stable-Baselines3's PPO."""

from stable_baselines3 import PPO

from trainer.bench.peers.corridor_arrays import CorridorArrays
from trainer.bench.peers.corridor_slots import CorridorSlots, TakeTurns
from trainer.bench.peers.peer_settings import PeerSettings

FOR_EVER = 10**12


def main(settings: PeerSettings) -> None:
    """Learns in turns."""
    corridor = CorridorArrays(settings.areas, settings.seed, settings.corridor, normalised=True)
    sizes = [settings.hidden_size] * 2
    model = PPO(
        "MlpPolicy",
        CorridorSlots(corridor),
        learning_rate=settings.learning_rate,
        n_steps=settings.n_steps,
        batch_size=settings.batch_size,
        n_epochs=settings.epochs,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip_range,
        clip_range_vf=settings.clip_range_vf,
        ent_coef=settings.ent_coef,
        vf_coef=settings.vf_coef,
        max_grad_norm=settings.max_grad_norm,
        policy_kwargs={"net_arch": {"pi": sizes, "vf": sizes}, "log_std_init": settings.log_std_init},
        seed=settings.seed,
        device="cpu",
    )
    model.learn(FOR_EVER, callback=TakeTurns(settings.warm_up, corridor), log_interval=FOR_EVER)


if __name__ == "__main__":
    main(PeerSettings.given())

"""The stages on an environment, lowest first: monitoring, normalisation, curiosity, deferring, and the algorithm."""

from dataclasses import dataclass

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.learning.algorithms import build_algorithm, steps_per_update
from trainer.learning.curiosity import Curiosity
from trainer.learning.deferring import Deferring
from trainer.learning.monitor import EpisodeMonitor
from trainer.learning.normaliser import ObservationNormaliser


@dataclass(frozen=True)
class Stages:
    """What ``build_stages`` has put on an environment."""

    monitor: EpisodeMonitor
    normaliser: ObservationNormaliser
    curiosity: Curiosity | None
    top: Deferring
    model: BaseAlgorithm


def build_stages(config: RunConfig, environments: VecEnv) -> Stages:
    """Puts monitoring, normalisation (eq. 7), curiosity and the algorithm on environments.

    Raises:
        TrainerError: Curiosity or the algorithm can't take the environments' observations or actions.
    """
    torch.set_num_threads(1)  # small networks: a second thread only takes the player's core
    monitor = EpisodeMonitor(environments)
    normaliser = ObservationNormaliser(monitor)
    curiosity = None
    if config.curiosity.c > 0:
        try:
            curiosity = Curiosity(normaliser, config.curiosity, steps_per_update(config), config.seed)
        except ValueError as error:
            raise TrainerError(f"{error} Or train without curiosity: --c 0.") from error
    top = Deferring(normaliser if curiosity is None else curiosity)
    return Stages(monitor, normaliser, curiosity, top, build_algorithm(config, top))

"""What a run begins as, before anything else is asked for."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trainer.config import PresetName, RunConfig
from trainer.corridor import CORRIDOR, DEFAULT_PENALTY
from trainer.hyperparameters import OTHERS, Algorithm, CuriosityConfig, Intrinsic, OtherConfig, PPOConfig

CURIOSITY_RATIO = 0.3  # what the case studies have


@dataclass(frozen=True)
class Preset:
    """A way to train.

    Attributes:
        num_areas: In each player.
        through_gym: One area through ``UnityToGymWrapper``, instead of all agents in lockstep.
        ppo: PPO's hyperparameters, and what other algorithms have in common with it.
        curiosity: The intrinsic reward, and how its networks learn.
        corridor: Environment parameters over those of the corridor that all presets train in.
    """

    num_areas: int
    through_gym: bool
    ppo: PPOConfig
    curiosity: CuriosityConfig
    corridor: Mapping[str, float] = field(default_factory=dict)


PRESETS: dict[PresetName, Preset] = {
    "fast": Preset(num_areas=128, through_gym=False, ppo=PPOConfig(), curiosity=CuriosityConfig()),
    # More than twice the r_i, of a quicker encoder: what the studies of algorithms and of doses were made with
    # (docs/studies.md).
    "case-studies": Preset(
        num_areas=128,
        through_gym=False,
        ppo=PPOConfig(),
        curiosity=CuriosityConfig(scale=3.0, encoder_rate=0.01, rnd_scale=1.8),
    ),
    # A longer way, a smaller gamma and an r_i of steady size: curiosity begins to overwhelm between c = 0.3 and 0.5
    # (docs/threshold.md).
    "threshold": Preset(
        num_areas=128,
        through_gym=False,
        ppo=PPOConfig(gamma=0.91),
        curiosity=CuriosityConfig(scale=0.17, feature_error="over_variance"),
        corridor={"goal_x": 8.0, "half_width": 6.5, "opponent_target_z": 1.0},
    ),
    # One area, 128 steps and 4 minibatches per update, as the Stable Baselines release that the paper used; a sixteenth
    # of fast's steps in an update bear a lower rate only (docs/calibration.md). Curiosity is what its full runs had
    # (docs/studies.md).
    "paper": Preset(
        num_areas=1,
        through_gym=True,
        ppo=PPOConfig(n_steps=128, minibatches=4, learning_rate=1e-4),
        curiosity=CuriosityConfig(feature_size=16, minibatches=4, scale=4.0, encoder_rate=0.01, rnd_scale=2.4),
    ),
}


def preset_run(
    run_id: str,
    preset: PresetName,
    *,
    c: float,
    seed: int,
    steps: int,
    env: str = "builtin",
    algo: Algorithm = "ppo",
    penalty: float = DEFAULT_PENALTY,
    num_areas: int | None = None,
    intrinsic: Intrinsic = "icm",
    environment_parameters: dict[str, Any] | None = None,
    base: Preset | None = None,
    own: OtherConfig | None = None,
    **others: Any,
) -> RunConfig:
    """A run with a preset's hyperparameters and corridor, but for what is given.

    Args:
        run_id: Its name, as this and most others are RunConfig's.
        preset: Which.
        c: Curiosity's.
        seed: The run's.
        steps: To train for.
        env: Where the players are.
        algo: What learns.
        penalty: Of a failed episode.
        num_areas: In each player; None is the preset's.
        intrinsic: What curiosity is paid for.
        environment_parameters: Over those of the preset's corridor.
        base: Has the hyperparameters in the preset's place.
        own: What the algorithm has for itself; None is its defaults.
        **others: RunConfig's.
    """
    chosen, given = base or PRESETS[preset], environment_parameters or {}
    both_ends = {f"{name}_{end}" for name in given for end in ("min", "max")}  # "agent_spawn_x" sets both
    corridor = {name: value for name, value in {**CORRIDOR, **chosen.corridor}.items() if name not in both_ends}
    return RunConfig(
        run_id=run_id,
        env=env,
        preset=preset,
        algo=algo,
        seed=seed,
        penalty=penalty,
        steps=steps,
        num_areas=chosen.num_areas if num_areas is None else num_areas,
        through_gym=chosen.through_gym,
        ppo=chosen.ppo,
        curiosity=dataclasses.replace(chosen.curiosity, c=c, intrinsic=intrinsic),
        other=own or (OTHERS[algo]() if algo in OTHERS else None),
        environment_parameters={**corridor, **given},
        preset_parameters=[name for name in corridor if name not in given],
        **others,
    )

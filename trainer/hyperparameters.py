"""Hyperparameters of the paper's runs: of the algorithms of section III-A, and of curiosity.

Names are Stable-Baselines3's; the defaults are those of preset ``fast``.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from corridor_server.shared.given import Range
from trainer.options import Count, Positive, Ratio, Settings, Share, Units

Algorithm = Literal["ppo", "a2c", "trpo", "ddpg"]
Intrinsic = Literal["icm", "rnd"]


@dataclass(frozen=True)
class PPOConfig(Settings):
    """Hyperparameters of Stable-Baselines3's PPO (section III-A).

    Attributes:
        n_steps: Steps of each area in an update.
        minibatches: Minibatches that an update's steps are cut into.
        epochs: Passes over an update's steps.
        learning_rate: Adam's, at the beginning.
        anneal: Lower the learning rate linearly to 0 over the run.
        gamma: Discount factor of eq. 1.
        gae_lambda: Generalised advantage estimation's lambda.
        clip_range: Epsilon of eq. 5.
        clip_range_vf: The same for the value function.
        ent_coef: Weight of the entropy bonus.
        vf_coef: Weight of the value loss.
        max_grad_norm: Limit of the gradient's norm.
        hidden_size: Units in each of the two hidden layers of actor and critic, which share none.
        log_std_init: Logarithm of the actions' standard deviation at the beginning.
    """

    SECTION: ClassVar = "hyperparameters"
    n_steps: Count = 16
    minibatches: Count = 8
    epochs: Count = 4
    learning_rate: Positive = 5e-4
    anneal: bool = True
    gamma: Share = 0.96
    gae_lambda: Share = 0.95
    clip_range: Positive = 0.2
    clip_range_vf: Positive = 0.2
    ent_coef: Positive = 0.0
    vf_coef: Positive = 0.5
    max_grad_norm: Positive = 0.5
    hidden_size: Units = 64
    log_std_init: float = -0.5


@dataclass(frozen=True)
class A2CConfig(Settings):
    """What A2C, the synchronous A3C (section III-A), has for itself; the rest is PPO's.

    Attributes:
        n_steps: Steps of each area in an update.
        learning_rate: RMSProp's, at the beginning.
    """

    SECTION: ClassVar = "own_hyperparameters"
    n_steps: Count = 5
    learning_rate: Positive = 7e-4


@dataclass(frozen=True)
class TRPOConfig(Settings):
    """What TRPO (section III-A) has for itself; the rest is PPO's, the steps in an update too.

    Attributes:
        learning_rate: Adam's for the value function, at the beginning.
        target_kl: Bound on the divergence between old and new policy.
    """

    SECTION: ClassVar = "own_hyperparameters"
    learning_rate: Positive = 1e-3
    target_kl: Positive = 0.01


@dataclass(frozen=True)
class DDPGConfig(Settings):
    """What DDPG (section III-A) has for itself; gamma and network sizes are PPO's.

    Attributes:
        learning_rate: Adam's.
        buffer_size: Transitions in the replay buffer.
        learning_starts: Agent steps of random actions before the first update.
        batch_size: Transitions in a gradient step.
        gradient_steps: After every step of all areas.
        tau: How far the target networks move in a gradient step.
        action_noise: Deviation of the Gaussian noise on actions.
    """

    SECTION: ClassVar = "own_hyperparameters"
    learning_rate: Positive = 1e-3
    buffer_size: Count = 1_000_000
    learning_starts: Annotated[int, Range(0)] = 10_000
    batch_size: Count = 256
    gradient_steps: Count = 8
    tau: Share = 0.005
    action_noise: Positive = 0.2


@dataclass(frozen=True)
class CuriosityConfig(Settings):
    """How curious the agent is, and how its curiosity learns (section III-B).

    Attributes:
        c: Limits the intrinsic reward before it is added to the extrinsic one (the paper's curiosity ratio).
        scale: Fixed factor on eq. 6, which brings r_i to the size that the paper's values of c presuppose.
        feature_size: Size of the encoding phi.
        hidden_size: Units in the hidden layer of each network.
        learning_rate: Adam's.
        encoder_rate: The encoder's part of it. A slow encoder keeps what the inverse model has no use for, such as the
            switch, in its features for longer.
        minibatches: Gradient steps per update; each transition is used once.
        forward_weight: Share of the forward model's loss; the inverse model has the rest.
        feature_error: How the squared error of a feature counts in eq. 6: ``plain``, or ``over_variance``, over the
            feature's running variance, so that r_i keeps its size over a run and from seed to seed. ICM's alone.
        intrinsic: ``icm``, the module of Fig. 2, or ``rnd``, random network distillation (ref. [14]).
        rnd_scale: ``scale`` for ``rnd``; with it, r_i is at first about as large as with ``icm`` and ``plain`` errors.
        next_state: What follows an episode's last state: ``terminal``, its own last observation, or ``reset``, the
            next episode's first, as a Gym loop that looks only at the returned observation has it.
    """

    SECTION: ClassVar = "curiosity"
    c: Ratio = 0.3
    scale: Positive = 1.25
    feature_size: Units = 32
    hidden_size: Units = 64
    learning_rate: Positive = 1e-3
    encoder_rate: Positive = 0.001
    minibatches: Count = 8
    forward_weight: Share = 0.2
    feature_error: Literal["plain", "over_variance"] = "plain"
    next_state: Literal["terminal", "reset"] = "reset"
    intrinsic: Intrinsic = "icm"
    rnd_scale: Positive = 0.75


OtherConfig = A2CConfig | TRPOConfig | DDPGConfig
OTHERS: dict[Algorithm, type[OtherConfig]] = {"a2c": A2CConfig, "trpo": TRPOConfig, "ddpg": DDPGConfig}

"""Actor and critic for whatever agents observe and do: continuous actions, discrete branches with masks, or both.

The distributions are Stable-Baselines3's, written out: its objects take longer to make than these networks to run.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import Tensor, nn

from corridor_server.protocol.agents import Behavior
from trainer.learning.observation_encoder import ConditioningType, ObservationEncoder, observation_space
from trainer.learning.picture_encoder import EncoderType

HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)
# A forbidden choice's logit: its probability is exactly 0, where minus infinity would give NaN in the entropy.
FORBIDDEN = torch.finfo(torch.float32).min
SMALLEST = torch.finfo(torch.float32).tiny


class Acted(NamedTuple):
    """What a policy decided for n agents.

    Attributes:
        continuous: (n, continuous actions) float32, not clipped.
        discrete: The choice in each branch, (n, branches) int64.
        log_probs: Of the whole action, (n,).
    """

    continuous: Tensor
    discrete: Tensor
    log_probs: Tensor


class ActorCritic(nn.Module):
    """Actor and critic, each with its own swish layers, behind one encoder of observations.

    Continuous actions are normally distributed with deviations that don't depend on observations; a discrete branch is
    categorical; all are independent of each other. Layers begin as ML-Agents' do, the encoder's as Stable-Baselines3's.

    In every method, observations come in the order of the behavior's sensors, each (n, *shape) float32, pictures from 0
    to 1; ``allowed`` is (n, sum of the branches) bool, True for what may be chosen, and None if everything may. What
    may not be chosen has probability 0, and a part neither in the entropy nor in a gradient; of a branch in which
    nothing may be chosen, everything may.

    Args:
        behavior: What agents observe and do.
        hidden_units: Units of each layer.
        num_layers: Layers of actor and critic.
        vis_encode_type: The network for pictures.
        goal_conditioning_type: What goal signals do; see ``ObservationEncoder``.
        value_heads: How many values the critic gives: one for each reward signal.
        log_std_init: Logarithm of the continuous actions' standard deviation at the beginning.
        shared_critic: Whether the critic has the actor's layers.

    Raises:
        TrainerError: A picture is too small for this network.
    """

    def __init__(
        self,
        behavior: Behavior,
        *,
        hidden_units: int = 128,
        num_layers: int = 2,
        vis_encode_type: EncoderType = "simple",
        goal_conditioning_type: ConditioningType = "hyper",
        value_heads: int = 1,
        log_std_init: float = 0.0,
        shared_critic: bool = False,
    ) -> None:
        super().__init__()
        self.encoder = ObservationEncoder(
            observation_space(behavior),
            behavior.sensors,
            hidden_units=hidden_units,
            vis_encode_type=vis_encode_type,
            goal_conditioning_type=goal_conditioning_type,
        )
        layers = [hidden_units] * num_layers
        architecture = {"pi": layers, "vf": [] if shared_critic else layers}
        self.mlp_extractor = MlpExtractor(self.encoder.features_dim, architecture, nn.SiLU, device="cpu")
        latent = self.mlp_extractor.latent_dim_pi
        self._continuous, self._branches = behavior.continuous_actions, behavior.discrete_branches
        self._shared = shared_critic
        self.action_net = nn.Linear(latent, self._continuous + sum(self._branches))
        self.value_net = nn.Linear(latent, value_heads)
        self.log_std = nn.Parameter(torch.full((self._continuous,), log_std_init))
        self.encoder.apply(partial(ActorCriticPolicy.init_weights, gain=math.sqrt(2.0)))
        self.mlp_extractor.apply(partial(_initialise, gain=1.0))
        _initialise(self.action_net, gain=0.2)
        nn.init.xavier_uniform_(self.value_net.weight)
        nn.init.zeros_(self.value_net.bias)

    @torch.no_grad()
    def act(self, observations: Sequence[Tensor], allowed: Tensor | None, deterministic: bool = False) -> Acted:
        """Samples an action for every agent, or takes the most likely one of each part; keeps no gradient."""
        means, logits = self._distributions(self._actor(self.encoder.encode(observations)), allowed)
        log_probs = means.new_zeros(len(means))
        continuous = means
        if self._continuous:
            noise = torch.zeros_like(means) if deterministic else torch.randn_like(means)
            continuous = torch.addcmul(means, noise, self.log_std.exp())
            log_probs = self._normal_log_probs(noise)
        choices = []
        for branch in logits:
            # The largest of logits plus Gumbel noise, which is finite: a sample of the categorical distribution.
            noisy = branch if deterministic else branch - _exponential(branch).log_()
            choices.append(noisy.argmax(dim=1, keepdim=True))
            log_probs = log_probs + branch.gather(1, choices[-1]).squeeze(1)
        discrete = torch.cat(choices, dim=1) if choices else torch.zeros(len(means), 0, dtype=torch.int64)
        return Acted(continuous, discrete, log_probs)

    def evaluate(
        self, observations: Sequence[Tensor], allowed: Tensor | None, continuous: Tensor, discrete: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What the policy now makes of actions that were taken, as ``act`` gave them.

        Returns:
            Values (n, value heads), log probabilities (n,) and entropies (n,).
        """
        features = self.encoder.encode(observations)
        latent = self._actor(features)
        values = self._critic(features, latent)
        means, logits = self._distributions(latent, allowed)
        log_probs = entropy = values.new_zeros(len(values))
        if self._continuous:
            log_probs = self._normal_log_probs((continuous - means) * (-self.log_std).exp())
            entropy = (self.log_std.sum() + self._continuous * (0.5 + HALF_LOG_TAU)).expand(len(values))
        for number, branch in enumerate(logits):
            log_probs = log_probs + branch.gather(1, discrete[:, number : number + 1]).squeeze(1)
            entropy = entropy - (branch.exp() * branch).sum(dim=1)
        return values, log_probs, entropy

    @torch.no_grad()
    def values(self, observations: Sequence[Tensor]) -> Tensor:
        """The critic's values, (n, value heads); keeps no gradient."""
        features = self.encoder.encode(observations)
        return self._critic(features, self._actor(features) if self._shared else features)

    def _actor(self, features: Tensor) -> Tensor:
        latent: Tensor = self.mlp_extractor.policy_net(features)
        return latent

    def _critic(self, features: Tensor, latent: Tensor) -> Tensor:
        values: Tensor = self.value_net(latent if self._shared else self.mlp_extractor.value_net(features))
        return values

    def _distributions(self, latent: Tensor, allowed: Tensor | None) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Means (n, continuous actions), and each branch's log probabilities (n, choices), of the actor's layers."""
        outputs: Tensor = self.action_net(latent)
        if not self._branches:
            return outputs, ()
        means, logits = outputs[:, : self._continuous], outputs[:, self._continuous :]
        if allowed is not None:
            logits = logits.masked_fill(~allowed, FORBIDDEN)
        branches = [branch.log_softmax(dim=1) for branch in torch.split(logits, list(self._branches), dim=1)]
        return means, tuple(branches)

    def _normal_log_probs(self, deviations: Tensor) -> Tensor:
        """Log probabilities, (n,), of actions that lie (n, continuous actions) standard deviations from the means."""
        constant = self.log_std.sum() + self._continuous * HALF_LOG_TAU
        return deviations.square().sum(dim=1) * -0.5 - constant


def _initialise(layer: nn.Module, gain: float) -> None:
    """Begins a dense layer with He's weights times a gain, and without biases."""
    if isinstance(layer, nn.Linear) and layer.out_features:  # torch warns of a layer without any
        nn.init.kaiming_normal_(layer.weight, nonlinearity="linear")
        layer.weight.data.mul_(gain)
        nn.init.zeros_(layer.bias)


def _exponential(like: Tensor) -> Tensor:
    """Exponentially distributed numbers of a tensor's shape, none of them 0, whose logarithm is infinite."""
    return torch.empty_like(like).exponential_().clamp_(min=SMALLEST)

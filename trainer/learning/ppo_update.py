"""PPO's update (eq. 5) on transitions of trajectories of any length, for a policy with any number of value heads."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.utils import explained_variance

from trainer.behavior_settings import PPOHyperparameters, Schedule
from trainer.learning.actor_critic import ActorCritic
from trainer.learning.adam_state import adam_state, load_adam_state
from trainer.learning.adam_steps import take_step
from trainer.learning.lean_actor_critic import LeanActorCritic, flat, normalised, policy_loss
from trainer.learning.tensors import tensor, tensors
from trainer.learning.transitions import Indices, Singles, Transitions

LEAST_BETA, LEAST_EPSILON, LEAST_RATE = 1e-5, 0.1, 1e-10  # where ML-Agents' linear schedules end
VALUE_WEIGHT = 0.5
# Of a minibatch: policy loss, value loss, entropy, share of clipped ratios, approximate KL divergence.
_Measures = tuple[float, float, float, float, float]


class PPOUpdate:
    """Improves a policy.

    The loss is Stable-Baselines3's: advantages are normalised in each minibatch, and values are not clipped. Gradients
    are not either, which is ML-Agents' way: large returns would leave the actor nothing of a norm that both share.
    Schedules are ML-Agents'.

    Args:
        policy: Which.
        settings: Of the update.
        lean: The policy in NumPy, if it has such a form: then it does the work.
    """

    def __init__(self, policy: ActorCritic, settings: PPOHyperparameters, lean: LeanActorCritic | None = None) -> None:
        self._policy, self._settings, self._lean = policy, settings, lean
        self._optimizer = torch.optim.Adam(policy.parameters(), lr=settings.learning_rate, eps=1e-5, fused=True)

    def update(
        self,
        transitions: Transitions,
        advantages: Singles,
        returns: Singles,
        values: Singles,
        progress: float,
        batches: Iterable[Indices],
    ) -> dict[str, float]:
        """Makes one update; returns what there is to log, by the tags of Stable-Baselines3 and ML-Agents.

        Args:
            transitions: What was done.
            advantages: Of each, (n,).
            returns: What each value head should have said, (n, heads).
            values: What the first value head said, (n,).
            progress: The share of the run that is behind, 0 to 1.
            batches: Which of them to learn from, one after another.
        """
        own = self._settings
        rate = scheduled(own.learning_rate, LEAST_RATE, own.learning_rate_schedule, progress)
        epsilon = scheduled(own.epsilon, LEAST_EPSILON, own.epsilon_schedule, progress)
        beta = scheduled(own.beta, LEAST_BETA, own.beta_schedule, progress)
        self._optimizer.param_groups[0]["lr"] = rate
        descend = self._descend_with_torch if self._lean is None else self._descend_lean
        measures = list(descend(batches, transitions, advantages, returns, epsilon, beta))
        policy_loss, value_loss, mean_entropy, clipped, divergence = np.mean(measures, axis=0).tolist()
        return {
            "train/policy_gradient_loss": policy_loss,
            "train/value_loss": value_loss,
            "train/entropy_loss": -mean_entropy,
            "train/approx_kl": divergence,
            "train/clip_fraction": clipped,
            "train/explained_variance": float(explained_variance(values, returns[:, 0])),
            "train/learning_rate": rate,
            "train/clip_range": epsilon,
            "Losses/Policy Loss": policy_loss,
            "Losses/Value Loss": value_loss,
            "Policy/Entropy": mean_entropy,
            "Policy/Learning Rate": rate,
            "Policy/Epsilon": epsilon,
            "Policy/Beta": beta,
        } | ({"train/std": float(self._policy.log_std.detach().exp().mean())} if len(self._policy.log_std) else {})

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Of Adam; see ``adam_state``."""
        return adam_state(self._optimizer)

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
        """
        load_adam_state(self._optimizer, state)

    def _descend_with_torch(
        self,
        batches: Iterable[Indices],
        transitions: Transitions,
        advantages: Singles,
        returns: Singles,
        epsilon: float,
        beta: float,
    ) -> Iterator[_Measures]:
        """A gradient step for each minibatch."""
        decided, device = transitions.decided, self._policy.log_std.device
        observations, allowed = tensors(transitions.observations, device), tensor(transitions.allowed, device)
        seen = torch.from_numpy(transitions.seen).to(device)
        continuous, discrete, old_log_probs = tensors(decided, device)
        advantage, target = tensors((advantages, returns), device)
        for indices in batches:
            rows = torch.from_numpy(indices).to(device)
            values, log_probs, entropy = self._policy.evaluate(
                tuple(each[seen[rows]] for each in observations),
                None if allowed is None else allowed[rows],
                continuous[rows],
                discrete[rows],
            )
            own_advantage = advantage[rows]
            if len(rows) > 1:
                own_advantage = (own_advantage - own_advantage.mean()) / (own_advantage.std() + 1e-8)
            log_ratio = log_probs - old_log_probs[rows]
            ratio = log_ratio.exp()
            limited = ratio.clamp(1 - epsilon, 1 + epsilon)
            policy_loss = -torch.minimum(own_advantage * ratio, own_advantage * limited).mean()
            value_loss = (target[rows] - values).square().mean()
            mean_entropy = entropy.mean()
            loss = policy_loss + VALUE_WEIGHT * value_loss - beta * mean_entropy
            self._optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            take_step(self._optimizer)
            with torch.no_grad():
                clipped = ((ratio - 1).abs() > epsilon).float().mean()
                divergence = (ratio - 1 - log_ratio).mean()
                found = torch.stack([policy_loss, value_loss, mean_entropy, clipped, divergence]).tolist()
            yield found[0], found[1], found[2], found[3], found[4]

    def _descend_lean(
        self,
        batches: Iterable[Indices],
        transitions: Transitions,
        advantages: Singles,
        returns: Singles,
        epsilon: float,
        beta: float,
    ) -> Iterator[_Measures]:
        """The same without torch."""
        assert self._lean is not None
        lean, decided, allowed = self._lean, transitions.decided, transitions.allowed
        observations = flat(transitions.observations)
        for rows in batches:
            seen, discrete = observations[transitions.seen[rows]], decided.discrete[rows]
            judged = lean.judge(seen, None if allowed is None else allowed[rows], decided.continuous[rows], discrete)
            log_ratio = judged.log_probs - decided.log_probs[rows]
            slope, (loss, clipped, divergence) = policy_loss(log_ratio, normalised(advantages[rows]), epsilon)
            lean.differentiate_actor(judged, discrete, slope, -beta)
            given, values = lean.critic(seen)
            error = values - returns[rows]
            lean.critic.differentiate(given, error * np.float32(2.0 * VALUE_WEIGHT / error.size))
            lean.adam.step(self._optimizer)
            value_loss = float(np.vdot(error, error)) / error.size
            yield loss, value_loss, float(judged.entropies.mean()), clipped, divergence


def scheduled(at_first: float, at_last: float, schedule: Schedule, progress: float) -> float:
    """A setting's value after a share of the run; a linear one that begins below its end stays there."""
    if schedule == "constant":
        return at_first
    return max(at_first + (at_last - at_first) * progress, min(at_first, at_last))


def minibatches(count: int, size: int, generator: np.random.Generator) -> Iterator[Indices]:
    """Random minibatches of about a size, equal to one: none is so small that it says nothing."""
    yield from np.array_split(generator.permutation(count), max(1, round(count / size)))

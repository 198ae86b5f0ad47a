"""PPO's update (eq. 5) on transitions of trajectories of any length, for a policy with any number of value heads."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.utils import explained_variance
from torch import Tensor

from trainer.behavior_settings import PPOHyperparameters, Schedule
from trainer.learning.actor_critic import ActorCritic
from trainer.learning.transitions import Indices, Singles, Transitions

LEAST_BETA, LEAST_EPSILON, LEAST_RATE = 1e-5, 0.1, 1e-10  # where ML-Agents' linear schedules end
VALUE_WEIGHT = 0.5
CPU = torch.device("cpu")
MOMENTS = ("step", "exp_avg", "exp_avg_sq")


class PPOUpdate:
    """Improves a policy.

    The loss is Stable-Baselines3's: advantages are normalised in each minibatch, and values are not clipped. Gradients
    are not either, which is ML-Agents' way: large returns would leave the actor nothing of a norm that both share.
    Schedules are ML-Agents'.

    Args:
        policy: Which.
        settings: Of the update.
    """

    def __init__(self, policy: ActorCritic, settings: PPOHyperparameters) -> None:
        self._policy, self._settings = policy, settings
        self._optimizer = torch.optim.Adam(policy.parameters(), lr=settings.learning_rate, eps=1e-5, fused=True)

    def update(
        self,
        transitions: Transitions,
        advantages: Singles,
        returns: Singles,
        progress: float,
        generator: np.random.Generator,
    ) -> dict[str, float]:
        """Makes one update; returns what there is to log, by the tags of Stable-Baselines3 and ML-Agents.

        Args:
            transitions: What was done.
            advantages: Of each, (n,).
            returns: What each value head should have said, (n, heads).
            progress: The share of the run that is behind, 0 to 1.
            generator: Draws the minibatches.
        """
        own = self._settings
        rate = scheduled(own.learning_rate, LEAST_RATE, own.learning_rate_schedule, progress)
        epsilon = scheduled(own.epsilon, LEAST_EPSILON, own.epsilon_schedule, progress)
        beta = scheduled(own.beta, LEAST_BETA, own.beta_schedule, progress)
        self._optimizer.param_groups[0]["lr"] = rate
        observed, decided = transitions.observed, transitions.decided
        device = self._policy.log_std.device
        observations, allowed = tensors(observed.observations, device), tensor(observed.allowed, device)
        continuous, discrete, old_log_probs, _ = tensors(decided, device)
        advantage, target = tensors((advantages, returns), device)
        measures = []
        for _ in range(own.num_epoch):
            for indices in minibatches(len(transitions), own.batch_size, generator):
                rows = torch.from_numpy(indices).to(device)
                values, log_probs, entropy = self._policy.evaluate(
                    tuple(each[rows] for each in observations),
                    None if allowed is None else allowed[rows],
                    continuous[rows],
                    discrete[rows],
                )
                measures.append(
                    self._descend(
                        values, log_probs, entropy, old_log_probs[rows], advantage[rows], target[rows], epsilon, beta
                    )
                )
        policy_loss, value_loss, mean_entropy, clipped, divergence = np.mean(measures, axis=0).tolist()
        return {
            "train/policy_gradient_loss": policy_loss,
            "train/value_loss": value_loss,
            "train/entropy_loss": -mean_entropy,
            "train/approx_kl": divergence,
            "train/clip_fraction": clipped,
            "train/explained_variance": float(explained_variance(decided.values[:, 0], returns[:, 0])),
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
        """Adam's moments of every parameter that has had a gradient, ``<kind>_<number>``."""
        state = {}
        for number, parameter in enumerate(self._policy.parameters()):
            for kind, value in self._optimizer.state[parameter].items():
                state[f"{kind}_{number}"] = value.cpu().numpy()
        return state

    def load_state_dict(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes over what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
        """
        for number, parameter in enumerate(self._policy.parameters()):
            if f"step_{number}" in state:  # not of the deviation of actions that have no numbers
                self._optimizer.state[parameter] = {
                    kind: torch.from_numpy(state[f"{kind}_{number}"].copy()).to(parameter.device) for kind in MOMENTS
                }

    def _descend(
        self,
        values: Tensor,
        log_probs: Tensor,
        entropy: Tensor,
        old_log_probs: Tensor,
        advantage: Tensor,
        target: Tensor,
        epsilon: float,
        beta: float,
    ) -> tuple[float, float, float, float, float]:
        """One gradient step; policy loss, value loss, entropy, share of clipped ratios, approximate KL divergence."""
        if len(advantage) > 1:
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        log_ratio = log_probs - old_log_probs
        ratio = log_ratio.exp()
        policy_loss = -torch.minimum(advantage * ratio, advantage * ratio.clamp(1 - epsilon, 1 + epsilon)).mean()
        value_loss = (target - values).square().mean()
        mean_entropy = entropy.mean()
        loss = policy_loss + VALUE_WEIGHT * value_loss - beta * mean_entropy
        self._optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        self._optimizer.step()
        with torch.no_grad():
            clipped = ((ratio - 1).abs() > epsilon).float().mean()
            divergence = (ratio - 1 - log_ratio).mean()
            found = torch.stack([policy_loss, value_loss, mean_entropy, clipped, divergence]).tolist()
        return found[0], found[1], found[2], found[3], found[4]


def scheduled(at_first: float, at_last: float, schedule: Schedule, progress: float) -> float:
    """A setting's value after a share of the run; a linear one that begins below its end stays there."""
    if schedule == "constant":
        return at_first
    return max(at_first + (at_last - at_first) * progress, min(at_first, at_last))


def minibatches(count: int, size: int, generator: np.random.Generator) -> Iterator[Indices]:
    """Random minibatches of about a size, equal to one: none is so small that it says nothing."""
    yield from np.array_split(generator.permutation(count), max(1, round(count / size)))


def tensors(arrays: Sequence[NDArray[Any]], device: torch.device = CPU) -> tuple[Tensor, ...]:
    """Arrays as torch has them there; on the CPU views."""
    return tuple(torch.from_numpy(each).to(device) for each in arrays)


def tensor(array: NDArray[Any] | None, device: torch.device = CPU) -> Tensor | None:
    """The same of one that may not be there."""
    return None if array is None else torch.from_numpy(array).to(device)

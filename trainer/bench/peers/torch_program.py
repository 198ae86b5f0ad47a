"""PPO in one file of plain torch, in CleanRL's manner: a loop to be copied, in which the environment is changed."""

import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Normal

from trainer.bench.peers.corridor_arrays import CorridorArrays
from trainer.bench.peers.peer_settings import PeerSettings
from trainer.bench.peers.turns import Turns

EPSILON = 1e-5  # Adam's, in CleanRL


def linear(inputs: int, outputs: int, gain: float) -> nn.Linear:
    """A dense layer, drawn orthogonally."""
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class TorchAgent(nn.Module):
    """An actor and a critic of two tanh layers each."""

    def __init__(self, size: int, action_size: int, hidden: int, log_std: float) -> None:
        super().__init__()

        def network(outputs: int, gain: float) -> nn.Sequential:
            first, second = linear(size, hidden, 2**0.5), linear(hidden, hidden, 2**0.5)
            return nn.Sequential(first, nn.Tanh(), second, nn.Tanh(), linear(hidden, outputs, gain))

        self.critic, self.actor = network(1, 1.0), network(action_size, 0.01)
        self.log_std = nn.Parameter(torch.full((1, action_size), log_std))

    def judge(self, observations: Tensor, actions: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Actions, (n, size), sampled where none are given, and their log probabilities, entropies and values, (n,)."""
        mean = self.actor(observations)
        normal = Normal(mean, self.log_std.expand_as(mean).exp())
        if actions is None:
            actions = normal.sample()  # type: ignore[no-untyped-call]
        return (
            actions,
            normal.log_prob(actions).sum(1),  # type: ignore[no-untyped-call]
            normal.entropy().sum(1),  # type: ignore[no-untyped-call]
            self.critic(observations).flatten(),
        )


def main(settings: PeerSettings) -> None:
    """Learns in turns."""
    torch.manual_seed(settings.seed)
    generator = np.random.default_rng(settings.seed)
    corridor = CorridorArrays(settings.areas, settings.seed, settings.corridor, normalised=True)
    agent = TorchAgent(corridor.size, corridor.action_size, settings.hidden_size, settings.log_std_init)
    optimizer = torch.optim.Adam(agent.parameters(), lr=settings.learning_rate, eps=EPSILON)
    shape = settings.n_steps, settings.areas
    observed, acted = torch.zeros(*shape, corridor.size), torch.zeros(*shape, corridor.action_size)
    log_probs, rewards, begins, values = (torch.zeros(shape) for _ in range(4))
    observation, begin = torch.from_numpy(corridor.reset()), torch.zeros(settings.areas)
    turns, loss = Turns(settings.warm_up), 0.0
    while turns.goes_on(corridor.steps, corridor.reward, loss):
        for step in range(settings.n_steps):
            observed[step], begins[step] = observation, begin
            with torch.no_grad():
                action, log_prob, _, value = agent.judge(observation)
            acted[step], log_probs[step], values[step] = action, log_prob, value
            stepped = corridor.step(np.clip(action.numpy(), -1.0, 1.0))
            rewards[step] = torch.from_numpy(stepped.rewards)
            observation = torch.from_numpy(stepped.observations)
            begin = torch.from_numpy((stepped.terminated | stepped.truncated).astype(np.float32))

        with torch.no_grad():
            following = agent.critic(observation).flatten()
        advantages, running = torch.zeros(shape), torch.zeros(settings.areas)
        for step in reversed(range(settings.n_steps)):
            last = step == settings.n_steps - 1
            runs_on = 1.0 - (begin if last else begins[step + 1])
            error = rewards[step] + settings.gamma * runs_on * (following if last else values[step + 1]) - values[step]
            running = error + settings.gamma * settings.gae_lambda * runs_on * running
            advantages[step] = running
        returns = advantages + values

        rows = [each.reshape(settings.rollout, -1) for each in (observed, acted)]
        columns = [each.reshape(settings.rollout) for each in (log_probs, advantages, returns, values)]
        for _ in range(settings.epochs):
            order = generator.permutation(settings.rollout)
            for start in range(0, settings.rollout, settings.batch_size):
                chosen = torch.from_numpy(order[start : start + settings.batch_size])
                observations, actions = (each[chosen] for each in rows)
                old_log_prob, advantage, target, old_value = (each[chosen] for each in columns)
                _, log_prob, entropy, value = agent.judge(observations, actions)
                ratio = (log_prob - old_log_prob).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                limited = ratio.clamp(1.0 - settings.clip_range, 1.0 + settings.clip_range)
                policy_loss = -torch.min(advantage * ratio, advantage * limited).mean()
                change = (value - old_value).clamp(-settings.clip_range_vf, settings.clip_range_vf)
                value_loss = (old_value + change - target).square().mean()
                total = policy_loss + settings.vf_coef * value_loss - settings.ent_coef * entropy.mean()
                optimizer.zero_grad()
                total.backward()  # type: ignore[no-untyped-call]
                nn.utils.clip_grad_norm_(agent.parameters(), settings.max_grad_norm)
                optimizer.step()
        loss = float(total.detach())


if __name__ == "__main__":
    main(PeerSettings.given())

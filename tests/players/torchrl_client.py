"""Holds our player against TorchRL's ``UnityMLAgentsEnv``, where this interpreter has it; prints what came as JSON.

``python torchrl_client.py PLAYER PORT ARGUMENT...``. TorchRL names an agent by its id, and refuses one that it has not
seen in the first message. Its own ``check_env_specs`` comes first, then 1,000 steps over many ends.
"""

import json
import sys

import trainer  # noqa: F401 - message classes for a current protobuf, before anything imports mlagents_envs

# isort: split
import torch
import torchrl
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from torchrl.envs import UnityMLAgentsEnv
from torchrl.envs.utils import check_env_specs

AREAS, STEPS = 3, 1000
PLAYER, PORT, ARGUMENTS = sys.argv[1], int(sys.argv[2]), sys.argv[3:]


def opened(number):
    parameters = EnvironmentParametersChannel()
    parameters.set_uniform_sampler_parameters("max_episode_steps", 5.0, 40.0, 1)  # the areas' episodes end apart
    return UnityMLAgentsEnv(
        PLAYER,
        base_port=PORT + number,
        no_graphics=True,
        timeout_wait=60,
        seed=1,
        num_areas=AREAS,
        side_channels=[parameters, StatsSideChannel()],
        additional_args=ARGUMENTS,
    )


def check():
    env = opened(0)
    check_env_specs(env)
    env.close()
    return {"check_env_specs": "passed"}


def play():
    env = opened(1)
    torch.manual_seed(0)
    steps = env.rollout(STEPS, break_when_any_done=False)
    agents = [(group, agent) for group, names in env.group_map.items() for agent in names]
    ends = {agent: int(steps["next", group, agent, "done"].sum()) for group, agent in agents}
    numbers = [value for value in steps.values(include_nested=True, leaves_only=True) if value.is_floating_point()]
    env.close()
    return {
        "steps": len(steps),
        "groups": {group: len(names) for group, names in env.group_map.items()},
        "ends": dict(sorted(ends.items())),
        "finite": all(bool(value.isfinite().all()) for value in numbers),
    }


if __name__ == "__main__":
    print(json.dumps({"torchrl": torchrl.__version__, **check(), **play()}))

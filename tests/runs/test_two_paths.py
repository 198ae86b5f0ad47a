"""The lockstep path is a special case of the collector's: the same player through both gives the same transitions."""

import numpy as np
from mlagents_envs.side_channel.environment_parameters_channel import EnvironmentParametersChannel

from corridor_server.protocol.agents import ActionBatch
from trainer.config import RestartLimits
from trainer.learning.experience import Experience
from trainer.learning.observation_scaling import ObservationScaling
from trainer.learning.transitions import Decided
from trainer.players.area_state import PlayerState
from trainer.players.connected import Connected
from trainer.players.failures import PlayerLogs
from trainer.players.opening import open_environment
from trainer.players.scene import Scene
from trainer.players.settings import set_parameters
from trainer.players.statistics_channel import Statistics
from trainer.players.vec_env import UnityVecEnv

AREAS, STEPS, SEED = 6, 400, 11
ENDS = {None: "", True: "truncated", False: "terminated"}
SHORT = {"max_episode_steps": 150.0}  # episodes that end in many ways


def connect(port, folder):
    statistics, parameters, state = Statistics(), EnvironmentParametersChannel(), PlayerState()
    set_parameters(parameters, SHORT, SEED)
    environment = open_environment(
        "builtin",
        seed=SEED,
        num_areas=AREAS,
        port=port,
        timeout_wait=60,
        side_channels=[statistics, parameters, state],
        log_folder=folder,
    )
    environment.reset()
    return Connected(environment, statistics, parameters, state, SEED)


def actions():
    return np.random.default_rng(3).uniform(-1, 1, (STEPS, AREAS, 2)).astype(np.float32)


def in_lockstep(port, folder):
    """Of each area: observation, action, reward, next observation, and how it ended, step by step."""
    slots = UnityVecEnv(connect(port, folder).environment)
    found = [[] for _ in range(AREAS)]
    try:
        observations = slots.reset()
        for chosen in actions():
            following, rewards, dones, infos = slots.step(chosen)
            for area in range(AREAS):
                last = infos[area]["terminal_observation"] if dones[area] else following[area]
                truncated = infos[area].get("TimeLimit.truncated", False)
                end = "truncated" if truncated else "terminated" if dones[area] else ""
                found[area].append((observations[area], chosen[area], rewards[area], last, end))
            observations = following
    finally:
        slots.close()
    return found


def by_agents(port, folder):
    """The same, as the collector has it."""
    scene = Scene(lambda number, life: connect(port, folder), [0], RestartLimits(), PlayerLogs(folder), True)
    found = [[] for _ in range(AREAS)]
    try:
        messages = scene.reset()
        (name,) = scene.behaviors
        behavior = scene.behaviors[name]
        experience, scaling = Experience(behavior, 10**6), ObservationScaling(behavior, normalize=False)
        ends, rest = {}, iter(actions())
        while True:
            (message,) = messages
            if name in message.ended:
                over = message.ended[name]
                closed = experience.end(0, name, over, scaling.of(over).observations)
                ends |= dict(zip(closed.tolist(), over.interrupted.tolist(), strict=True))
            batch = {}
            if name in message.asking:
                asking = message.asking[name]
                asked = experience.ask(0, name, asking, scaling.of(asking))
                chosen = next(rest, None)
                if chosen is None:
                    break
                mine, areas = chosen[asking.ids], asking.ids.astype(np.float32)
                nothing = np.zeros((AREAS, 0), np.int64)
                experience.act(asked, Decided(mine, nothing, areas))
                batch = {name: ActionBatch(mine, nothing.astype(np.int32))}
            scene.send([batch])
            messages = scene.receive()
        transitions, _ = experience.take()
    finally:
        scene.close()
    for row in range(len(transitions)):
        area = int(transitions.decided.log_probs[row])
        seen, then = transitions.observed[0][row], transitions.next_observed[0][row]
        action, reward = transitions.decided.continuous[row], transitions.rewards[row]
        found[area].append((seen, action, reward, then, ENDS[ends.get(row)]))
    return found


def test_the_same_player_through_both_paths_gives_the_same_transitions(free_port, tmp_path):
    one, other = in_lockstep(free_port, tmp_path / "one"), by_agents(free_port, tmp_path / "other")
    kinds = set()
    for area in range(AREAS):
        assert len(one[area]) == len(other[area]) == STEPS
        for mine, theirs in zip(one[area], other[area], strict=True):
            for part, same in zip(mine[:4], theirs[:4], strict=True):
                assert np.array_equal(part, same)
            assert mine[4] == theirs[4]
            kinds.add(mine[4])
    assert kinds == {"", "terminated", "truncated"}, "all ways to end are among them"

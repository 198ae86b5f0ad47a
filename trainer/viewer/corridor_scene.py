"""What the page shows of an evaluation: chosen episodes, number for number as they were recorded."""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor import observation as layout
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.gym_env import CorridorEnv
from trainer.config import RunConfig
from trainer.corridor import corridor_of, is_corridor
from trainer.errors import TrainerError
from trainer.runs.evaluation import Episode
from trainer.runs.trajectories import Trajectories
from trainer.seeds import player_seed

SHOWN = 20  # episodes on a page, unless told otherwise
ESTIMATE_BITS = 12  # of a value's or an intrinsic reward's mantissa: 3 digits, which is what the page shows
FOREIGN = (
    "The in-process world doesn't give these episodes (another player, or parameters drawn anew for each), so what the "
    "trainer can't see is not shown: the opponent's target and the switch's place; the corridor has its default sizes."
)


def run_scene(
    config: RunConfig, trajectories: Trajectories, episodes: int = SHOWN, number: int | None = None
) -> dict[str, Any]:
    """A run's evaluation for the page.

    Where the built-in player played it, its episodes are lived through again in the in-process world, action by
    action, which shows what the observation hides; it is believed only if every observation, reward and end is equal
    bit for bit.

    Args:
        config: The run.
        trajectories: Its evaluation.
        episodes: How many to show: failures, closest calls and successes in equal parts, as far as there are.
        number: Show this episode alone.

    Raises:
        TrainerError: The environment is not the corridor, or there is no such episode.
    """
    if not is_corridor(trajectories.behavior):
        raise TrainerError(f"The run's behavior is {trajectories.behavior}, but only the corridor can be shown.")
    corridor = corridor_of(config.penalty, config.environment_parameters)
    if number is None:
        chosen = choose(trajectories.episodes, episodes)
    else:
        check_episode(config, trajectories, number)
        chosen = [number]
    hidden = _hidden_targets(config, trajectories, chosen, corridor)
    return {
        "run": {**config.facts(), "steps": config.steps},
        "env_steps": trajectories.env_steps,
        "corridor": corridor_facts(corridor, switch_known=hidden is not None),
        "evaluated": len(trajectories.episodes),
        "notes": [FOREIGN] if hidden is None else [],
        "episodes": [
            episode_record(trajectories.episodes[row], row, corridor, None if hidden is None else hidden[row])
            for row in chosen
        ],
    }


def corridor_facts(corridor: CorridorConfig, *, switch_known: bool = True) -> dict[str, Any]:
    """Geometry and reward, in ``CorridorConfig``'s names and units; no switch where its place is not known."""
    return {
        "half_length": corridor.half_length,
        "half_width": corridor.half_width,
        "agent_radius": corridor.agent_radius,
        "opponent_radius": corridor.opponent_radius,
        "goal_radius": corridor.goal_radius,
        "near_distance": corridor.near_distance,
        "decision_seconds": corridor.decision_seconds,
        "failure_return": corridor.failure_return,
        "goal_reward": corridor.goal_reward,
        "wall_penalty": corridor.wall_penalty,
        "contact_penalty": corridor.contact_penalty,
        "near_penalty": corridor.near_penalty,
        "step_penalty": corridor.step_penalty,
        "failure_penalty": corridor.failure_penalty,
        "switch": {"x": corridor.switch_x, "z": corridor.switch_z, "radius": corridor.switch_radius}
        if switch_known
        else None,
    }


def choose(episodes: Sequence[Episode], count: int) -> list[int]:
    """Rows of ``count`` episodes: failures, closest calls (successes, by closest approach) and other successes.

    Each kind has a third of the places, and what others leave.
    """
    failures = [row for row, episode in enumerate(episodes) if not episode.succeeded]
    successes = [row for row, episode in enumerate(episodes) if episode.succeeded]
    close = sorted(successes, key=lambda row: (closest_approach(episodes[row]), row))
    chosen = [*failures[: count // 3], *close[: count // 3]]
    for row in [*successes, *failures]:
        if len(chosen) < count and row not in chosen:
            chosen.append(row)
    return sorted(chosen)


def closest_approach(episode: Episode) -> float:
    """Least d_opp after the start, in half-lengths, over all opponents."""
    return float(layout.opponent_blocks(episode.observations[1:])[..., layout.OPPONENT_DISTANCE].min())


def episode_record(
    episode: Episode, number: int, corridor: CorridorConfig, targets: NDArray[np.float64] | None
) -> dict[str, Any]:
    """One episode as the page reads it.

    Args:
        episode: Of the corridor.
        number: Its row in the evaluation.
        corridor: Where it was played.
        targets: The opponents' targets, (K, 2) m, if known.

    Returns:
        Facts, and ``data``: a float32 table of the columns in ``columns`` and length + 1 rows, column after column,
        deflated, as Base64. Row t is the state after t decisions, with the reward and action that led to it (0 in
        row 0), the critic's value of it, and what curiosity makes of the step to it. Units are the observation's.
    """
    observations = episode.observations
    nothing = np.zeros((1, *episode.actions.shape[1:]))
    columns = _columns(
        observations, np.concatenate([[0.0], episode.rewards]), np.concatenate([nothing, episode.actions])
    )
    if episode.values is not None:
        columns["value"] = _rounded(episode.values)
    if episode.intrinsic_rewards is not None:
        columns["intrinsic"] = _rounded(np.concatenate([[0.0], episode.intrinsic_rewards]))
    table = np.stack([column.astype("<f4") for column in columns.values()])
    # Bytes of the same significance side by side deflate to two thirds.
    shuffled = table.view(np.uint8).reshape(-1, 4).T.tobytes()
    return {
        "number": number,
        "length": len(episode.rewards),
        "outcome": outcome(episode),
        "return": float(episode.rewards.sum(dtype=np.float64)),
        "closest": closest_approach(episode),
        "goal": [float(value) * corridor.half_length for value in observations[0, layout.GOAL]],
        "opponent_targets": None if targets is None else targets.tolist(),
        "opponents": layout.opponents(observations.shape[1]),
        "columns": list(columns),
        "data": base64.b64encode(zlib.compress(shuffled, 9)).decode("ascii"),
    }


def state_row(
    observation: NDArray[np.float32], reward: float, action: Sequence[float] | NDArray[np.float32]
) -> dict[str, float]:
    """One row of an episode's table: a state, and the reward and action that led to it."""
    columns = _columns(observation[None], np.array([reward]), np.array([action]))
    return {name: float(column[0]) for name, column in columns.items()}


def _columns(observations: NDArray[Any], rewards: NDArray[Any], actions: NDArray[Any]) -> dict[str, NDArray[Any]]:
    x, z = observations[:, layout.POSITION].T
    columns = {"p_x": x, "p_z": z, "switch": observations[:, layout.SWITCH]}
    blocks = layout.opponent_blocks(observations)
    for k in range(blocks.shape[1]):
        x, z = blocks[:, k, layout.OPPONENT_POSITION].T
        columns |= {f"op{k}_x": x, f"op{k}_z": z, f"op{k}_d": blocks[:, k, layout.OPPONENT_DISTANCE]}
    return columns | {"reward": rewards, "a_x": actions[:, 0], "a_z": actions[:, 1]}


def _rounded(numbers: NDArray[Any]) -> NDArray[np.float32]:
    """Numbers to ``ESTIMATE_BITS``: the other bits of a network's output are noise, which doesn't deflate."""
    mantissa, exponent = np.frexp(numbers.astype(np.float32))
    rounded: NDArray[np.float32] = np.ldexp(np.rint(mantissa * 2.0**ESTIMATE_BITS), exponent - ESTIMATE_BITS)
    return rounded.astype(np.float32)


def outcome(episode: Episode) -> str:
    """How an episode ended: ``goal``, ``failed``, ``truncated``, or ``ended`` if the player doesn't say."""
    if episode.truncated:
        return "truncated"
    if episode.succeeded is None:
        return "ended"
    return "goal" if episode.succeeded else "failed"


def _hidden_targets(
    config: RunConfig, trajectories: Trajectories, rows: Sequence[int], corridor: CorridorConfig
) -> dict[int, NDArray[np.float64]] | None:
    """The opponents' targets in each of these episodes, (K, 2) m; None if the in-process world tells another story."""
    if trajectories.seed is None or trajectories.episodes[0].observations.shape[1] != corridor.observation_size:
        return None
    found = {}
    for row in rows:
        episode = trajectories.episodes[row]
        env, observation = _begun(config, trajectories, row, corridor, trajectories.seed)
        observations, rewards = [observation], []
        terminated = truncated = False
        for action in episode.actions:
            if terminated or truncated:
                return None
            observation, reward, terminated, truncated, _ = env.step(action)
            observations.append(observation)
            rewards.append(reward)
        same_end = (terminated or truncated) and truncated == episode.truncated
        same_numbers = np.array_equal(observations, episode.observations) and np.array_equal(
            np.array(rewards, np.float32), episode.rewards
        )
        if not (same_end and same_numbers):
            return None
        found[row] = env.state.opponent_target[0]
    return found


def begin_again(config: RunConfig, trajectories: Trajectories, number: int) -> tuple[CorridorEnv, NDArray[np.float32]]:
    """An evaluated episode from its start, for somebody else to play.

    Args:
        config: The run.
        trajectories: Its evaluation.
        number: The episode's row in it.

    Returns:
        The in-process world, and its first observation, which is the recorded one.

    Raises:
        TrainerError: There is no such episode, or the in-process world doesn't begin it as it was recorded.
    """
    check_episode(config, trajectories, number)
    corridor = corridor_of(config.penalty, config.environment_parameters)
    recorded = trajectories.episodes[number].observations[0]
    if trajectories.seed is not None and recorded.shape == (corridor.observation_size,):
        env, observation = _begun(config, trajectories, number, corridor, trajectories.seed)
        if np.array_equal(observation, recorded):
            return env, observation
    raise TrainerError(
        f"Episode {number} of {config.run_id} can't begin here as it was recorded (another player, or parameters drawn "
        "anew for each); drive a new episode."
    )


def check_episode(config: RunConfig, trajectories: Trajectories, number: int) -> None:
    """Refuses an episode that there isn't.

    Raises:
        TrainerError: There are fewer.
    """
    count = len(trajectories.episodes)
    if not 0 <= number < count:
        raise TrainerError(f"There is no episode {number} of {config.run_id}, whose evaluation has {count}, from 0.")


def _begun(
    config: RunConfig, trajectories: Trajectories, number: int, corridor: CorridorConfig, seed: int
) -> tuple[CorridorEnv, NDArray[np.float32]]:
    """The in-process world at an episode's start: a slot's episodes follow from one another."""
    slot = trajectories.episodes[number].slot
    player, area = divmod(slot, config.num_areas)
    env = CorridorEnv(area=area, **asdict(corridor))
    observation, _ = env.reset(seed=player_seed(seed, player))
    before = sum(other.slot == slot for other in trajectories.episodes[:number])
    for _ in range(before + config.through_gym):  # UnityToGymWrapper resets once more before the first
        observation, _ = env.reset()
    return env, observation

"""What ``corridor train`` and ``corridor evaluate`` do: a run from the player's start to its files."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from trainer.config import RestartLimits, RunConfig
from trainer.errors import TrainerError
from trainer.learning.sb3_zip import load_sb3_policy
from trainer.players.behavior import behavior_record
from trainer.players.environment import LOOPBACK, can_be_launched, is_corridor
from trainer.players.settings import corridor_of
from trainer.players.several import open_player
from trainer.runs.checkpoint import Checkpoint, checkpoints, read_checkpoint
from trainer.runs.evaluation import Episode, evaluate, summarise
from trainer.runs.figures import save_episode_paths, save_learning_curve
from trainer.runs.folder import RunFolder
from trainer.runs.run_state import player_states, policy_sha256
from trainer.runs.training import Counters, build_stages, load_trained, train
from trainer.runs.trajectories import Trajectories, save_trajectories

ONLY_WEIGHTS = (
    "Warning: of {}, only the policy's weights are used. Its pickled part (settings, optimiser) is not read, and it "
    "has no observation statistics: normalisation begins anew, so the policy first acts differently."
)
# Evaluation plays episodes that training has not seen.
EVALUATION_SEED_OFFSET = 1_000_000


def train_run(
    config: RunConfig,
    folder: RunFolder,
    *,
    port: int,
    timeout_wait: int,
    episodes: int,
    resumed: bool,
    limits: RestartLimits = RestartLimits(),  # noqa: B008 - frozen
    listen: str = LOOPBACK,
) -> bool:
    """Trains, evaluates and writes the run's summary and pictures.

    Returns:
        Whether the run took all its steps; False if a signal ended it, in which case it is not evaluated.

    Raises:
        TrainerError: The player can't be started, does not fit, or failed; what was learned until then is saved.
    """
    with _written_to(folder):
        console = Console()
        evaluated: list[Episode] | None = None
        seed: int | None = None
        # A run that was killed before its first update begins again.
        checkpoint = read_checkpoint(folder.checkpoints) if resumed and checkpoints(folder.checkpoints) else None
        counters, lives, states = Counters(), None, None
        if checkpoint is not None:
            counters, lives, states = _so_far(checkpoint, config)
        first_step, first_second = counters.env_steps, counters.wall_seconds
        with open_player(
            config,
            folder.logs,
            seed=config.seed,
            port=port,
            timeout_wait=timeout_wait,
            limits=limits,
            lives=lives,
            states=states,
            listen=listen,
        ) as (player, behavior):
            folder.record_behavior(behavior_record(behavior, player.behavior_spec))
            stages = build_stages(config, player)
            if config.from_sb3 is not None and checkpoint is None:
                load_sb3_policy(Path(config.from_sb3), stages.model)
                console.print(ONLY_WEIGHTS.format(config.from_sb3), style="yellow", highlight=False, markup=False)
            finished = train(config, folder, stages, counters, checkpoint)
            policy = policy_sha256(stages.model)
            if finished and not can_be_launched(config.env):
                evaluated = evaluate(stages.model, stages.normaliser, player, episodes)
        if finished and evaluated is None:
            seed = evaluation_seed(config)
            with _evaluation_player(config, folder, port, timeout_wait, limits, listen) as (player, _):
                evaluated = evaluate(stages.model, stages.normaliser, player, episodes)

        if evaluated is not None:
            save_trajectories(folder.trajectories, Trajectories(behavior, seed, counters.env_steps, evaluated))
        seconds = counters.wall_seconds - first_second
        folder.write_summary(
            {
                **config.facts(),
                "env_steps": counters.env_steps,
                "episodes": counters.episodes,
                "wall_seconds": round(counters.wall_seconds, 3),
                "steps_per_second": round((counters.env_steps - first_step) / seconds, 1) if seconds else None,
                "steps_to_50_success": counters.steps_to_50_success,
                "steps_to_90_success": counters.steps_to_90_success,
                "evaluation": summarise(evaluated) if evaluated else None,
                "policy_sha256": policy,
                "restarts": counters.restarts + counters.resumes,
                "player_restarts": counters.restarts,
                "resumes": counters.resumes,
                "exchange_share": round(counters.exchange_seconds / counters.wall_seconds, 3)
                if counters.wall_seconds
                else None,
            }
        )
        title = f"{config.run_id} (c = {config.curiosity.c:g}, seed {config.seed})"
        save_learning_curve(folder.read_progress(), title, folder.learning_curve)
        if evaluated is None:
            console.print(f"Stopped at {counters.env_steps:,} steps and saved; go on with --resume.", highlight=False)
        else:
            _report(console, folder, config, evaluated, title, behavior)
        return finished


def evaluate_run(
    config: RunConfig,
    folder: RunFolder,
    *,
    port: int,
    timeout_wait: int,
    episodes: int,
    checkpoint: str | None = None,
    listen: str = LOOPBACK,
) -> None:
    """Evaluates a checkpoint, the newest if none is named, on the episodes that the run's own evaluation played.

    Raises:
        TrainerError: There is no such checkpoint, it does not fit, or the player failed.
    """
    evaluated = play_episodes(
        config,
        folder,
        port=port,
        timeout_wait=timeout_wait,
        episodes=episodes,
        checkpoint=checkpoint,
        listen=listen,
    )
    save_trajectories(folder.trajectories, evaluated)
    title = f"{config.run_id} (c = {config.curiosity.c:g}, seed {config.seed})"
    _report(Console(), folder, config, evaluated.episodes, title, evaluated.behavior)


def play_episodes(
    config: RunConfig,
    folder: RunFolder,
    *,
    port: int,
    timeout_wait: int,
    episodes: int,
    checkpoint: str | None = None,
    listen: str = LOOPBACK,
) -> Trajectories:
    """Plays a checkpoint, the newest if none is named, on the episodes that the run's own evaluation played.

    Raises:
        TrainerError: There is no such checkpoint, it does not fit, or the player failed.
    """
    read_checkpoint(folder.checkpoints, checkpoint)  # before a player is started, or waited for
    with _evaluation_player(config, folder, port, timeout_wait, RestartLimits(), listen) as (player, behavior):
        stages = build_stages(config, player)
        counters = load_trained(config, folder, stages, checkpoint)
        played = evaluate(stages.model, stages.normaliser, player, episodes)
    return Trajectories(behavior, evaluation_seed(config), counters.env_steps, played)


def evaluation_seed(config: RunConfig) -> int:
    """The seed of the player that a run is evaluated on."""
    return (config.seed + EVALUATION_SEED_OFFSET) % 2**31


def _so_far(checkpoint: Checkpoint, config: RunConfig) -> tuple[Counters, list[int], list[bytes] | None]:
    """A checkpoint's counters, how often its players were started before, and their states.

    Raises:
        TrainerError: It has another number of players.
    """
    counters = Counters(**checkpoint.facts["counters"])
    lives, states = checkpoint.facts["lives"], player_states(checkpoint)
    if len(lives) != config.num_envs:
        raise TrainerError(
            f"The checkpoint is of a run with {len(lives)} players, but --num-envs is {config.num_envs}."
        )
    if states is None:  # with its former seed, a player would play the run's first episodes once more
        lives = [life + 1 for life in lives]
    return replace(counters, resumes=counters.resumes + 1), lives, states


@contextmanager
def _written_to(folder: RunFolder) -> Iterator[None]:
    """Turns a full disk, or a folder that can't be written, into one sentence."""
    try:
        yield
    except OSError as error:
        kept = [path.name for path in checkpoints(folder.checkpoints)]
        known = (
            f"the last checkpoint is {kept[-1]}: put it right and go on with --resume." if kept else "nothing is saved."
        )
        raise TrainerError(f"{folder.path} can't be written ({error.strerror or error}); {known}") from error


def _evaluation_player(
    config: RunConfig, folder: RunFolder, port: int, timeout_wait: int, limits: RestartLimits, listen: str
) -> Any:
    logs, seed = folder.logs / "evaluation", evaluation_seed(config)
    return open_player(config, logs, seed=seed, port=port, timeout_wait=timeout_wait, limits=limits, listen=listen)


def _report(
    console: Console, folder: RunFolder, config: RunConfig, episodes: list[Episode], title: str, behavior: str
) -> None:
    console.print(f"Evaluation of {title}, deterministic policy:", highlight=False, soft_wrap=True)
    table = Table("measure", "value")
    for name, value in summarise(episodes).items():
        table.add_row(name, "not reported" if value is None else f"{value:g}")
    console.print(table)
    if is_corridor(behavior):
        shown = next((episode for episode in episodes if episode.succeeded), episodes[0])
        save_episode_paths(shown, title, folder.episode_paths, corridor_of(config))
    console.print(f"Results: {_relative(folder.path)}", highlight=False, soft_wrap=True)


def _relative(path: Path) -> Path:
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path

"""What ``corridor train`` and ``corridor evaluate`` do: a run from the player's start to its files."""

import errno
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from rich.table import Table
from stable_baselines3.common.vec_env import VecEnv

from trainer.activity import doing
from trainer.config import ConnectionOptions, RestartLimits, RunConfig
from trainer.corridor import DEFAULT_PENALTY, corridor_of, is_corridor
from trainer.curriculum import Curricula
from trainer.drafts import Draft, written
from trainer.errors import TrainerError
from trainer.learning.algorithm_state import policy_sha256
from trainer.learning.kernels import PROBLEM
from trainer.learning.sb3_zip import load_sb3_policy
from trainer.learning.stages import Stages, build_stages
from trainer.players.behavior import behavior_record
from trainer.players.failures import PlayerLogs
from trainer.players.location import can_be_launched
from trainer.players.opening import open_players, open_slots
from trainer.players.scene import Scene
from trainer.players.several import Players
from trainer.runs.behavior_learners import plain_behavior
from trainer.runs.checkpoint import Checkpoint, checkpoints
from trainer.runs.counters import Counters
from trainer.runs.estimates import with_estimates
from trainer.runs.evaluation import Episode, evaluate, summarise, unreported
from trainer.runs.folder import RunFolder
from trainer.runs.next_steps import next_steps
from trainer.runs.opened_players import opened
from trainer.runs.run_state import Resumed, resumed_from
from trainer.runs.scene_run import LearnedScene, evaluate_scene_run, is_of_scene, learn_scene, report_scene
from trainer.runs.training import load_trained, train
from trainer.runs.trajectories import Trajectories, save_trajectories
from trainer.seeds import evaluation_seed
from trainer.terminal import Terminal

ONLY_WEIGHTS = (
    "Warning: of {}, only the policy's weights are used. Its pickled part (settings, optimiser) is not read, and it "
    "has no observation statistics: normalisation begins anew, so the policy first acts differently."
)

# Of a write that failed, where the error does not say of which file.
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.ESTALE)


@dataclass(frozen=True)
class _Learned:
    """What learning leaves.

    Attributes:
        finished: Whether it took all its steps.
        stages: With the policy.
        counters: Of the whole run.
        before: Of its earlier parts.
        behavior: The behavior's name.
        evaluated: By players that can't be launched anew; None if there is an evaluation to come, or none at all.
    """

    finished: bool
    stages: Stages
    counters: Counters
    before: Counters
    behavior: str
    evaluated: list[Episode] | None


def train_run(
    config: RunConfig,
    folder: RunFolder,
    draft: Draft,
    connection: ConnectionOptions,
    *,
    episodes: int,
    resumed: bool = False,
    limits: RestartLimits = RestartLimits(),  # noqa: B008 - frozen
) -> bool:
    """Trains, evaluates and writes the run's summary and pictures.

    Args:
        config: The run.
        folder: Where its results go.
        draft: Of the folder; published once the players are open and fit.
        connection: How its players are reached.
        episodes: Of its evaluation.
        resumed: Whether it goes on from its newest checkpoint.
        limits: How often a player may be started again.

    Returns:
        Whether the run took all its steps; False if a signal ended it, in which case it is not evaluated.

    Raises:
        TrainerError: The player can't be started, does not fit, or failed; what was learned until then is saved.
    """
    if PROBLEM is not None:
        Terminal(stderr=True).print(PROBLEM, style="yellow")
    with _written_to(folder):
        learned = _learn(config, folder, draft, connection, episodes, resumed, limits)
        if isinstance(learned, LearnedScene):
            report_scene(config, folder, connection, episodes, limits, learned)
            return learned.finished
        evaluation = _evaluate(config, folder, connection, episodes, limits, learned)
        _report(config, folder, learned, evaluation)
    return learned.finished


def _learn(
    config: RunConfig,
    folder: RunFolder,
    draft: Draft,
    connection: ConnectionOptions,
    episodes: int,
    resumed: bool,
    limits: RestartLimits,
) -> _Learned | LearnedScene:
    # A run that was killed before its first update begins again.
    checkpoint = folder.read_checkpoint(config) if resumed and checkpoints(folder.checkpoints) else None
    so_far = Resumed() if checkpoint is None else resumed_from(checkpoint, config.num_envs)
    counters, drafted = replace(so_far.counters), RunFolder(draft.path)
    curricula = Curricula(config.environment_parameters)
    if checkpoint is not None and is_of_scene(checkpoint):
        curricula.load_state_dict(checkpoint.part("curricula"))
    logs = PlayerLogs(drafted.logs, stay=False)
    opening = open_players(
        config,
        logs,
        connection,
        seed=config.seed,
        limits=limits,
        lives=so_far.lives,
        states=so_far.states,
        curricula=curricula,
    )
    with opened(opening, config) as players:
        if isinstance(players, Scene):

            def begin_scene(agents: int) -> None:
                _check_penalty(config, players.behaviors, checkpoint)
                _check_intrinsic(config, players.behaviors)
                described = {name: plain_behavior(each) for name, each in players.behaviors.items()}
                drafted.record_scene(config, described, agents)
                draft.publish()
                logs.folder, logs.stay = folder.logs, True
                if agents < config.num_areas:
                    _say_who_came(config.num_areas, agents)

            return learn_scene(config, folder, players, counters, curricula, begin_scene, checkpoint, episodes)
        if config.device == "cuda":
            raise TrainerError(
                "--device cuda has no effect on this run, whose networks are too small for a GPU; leave it out."
            )
        _check_penalty(config, [players.behavior], checkpoint)

        def begin() -> None:
            drafted.record(config, behavior_record(players.behavior, players.behavior_spec), players.areas)
            draft.publish()
            logs.folder, logs.stay = folder.logs, True

        if players.areas != config.num_areas:
            _say_who_came(config.num_areas, players.areas)
        stages = build_stages(config, players)
        if config.from_sb3 is not None and checkpoint is None:
            load_sb3_policy(Path(config.from_sb3), stages.model)
            warning = ONLY_WEIGHTS.format(config.from_sb3)
            Terminal().print(warning, style="yellow")
        finished = train(config, folder, stages, players, counters, begin, checkpoint)
        evaluated = None
        if finished and not can_be_launched(config.env):
            evaluated = _play(stages, players, episodes)
        return _Learned(finished, stages, counters, so_far.counters, players.behavior, evaluated)


def _play(stages: Stages, players: VecEnv, episodes: int) -> list[Episode]:
    with doing(f"Playing the evaluation's {episodes} episodes", episodes) as tell:
        played = evaluate(stages.model, stages.normaliser, players, episodes, tell=tell)
    return with_estimates(stages, played)


def _evaluate(
    config: RunConfig,
    folder: RunFolder,
    connection: ConnectionOptions,
    episodes: int,
    limits: RestartLimits,
    learned: _Learned,
) -> Trajectories | None:
    """The finished run's evaluation, recorded; None for a run that was ended before."""
    played, seed = learned.evaluated, None
    if not learned.finished:
        return None
    if played is None:
        seed = evaluation_seed(config.seed)
        logs = PlayerLogs(folder.evaluation_logs)
        with _evaluation_players(config, logs, connection, limits) as players:
            played = _play(learned.stages, players, episodes)
    evaluation = Trajectories(learned.behavior, seed, learned.counters.env_steps, played)
    _save_evaluation(config, folder, evaluation)
    return evaluation


def _report(config: RunConfig, folder: RunFolder, learned: _Learned, evaluation: Trajectories | None) -> None:
    counters, before = learned.counters, learned.before
    seconds = counters.wall_seconds - before.wall_seconds
    exchange = round(counters.exchange_seconds / counters.wall_seconds, 3) if counters.wall_seconds else None
    folder.write_summary(
        {
            **config.facts(),
            "env_steps": counters.env_steps,
            "episodes": counters.episodes,
            "wall_seconds": round(counters.wall_seconds, 3),
            "steps_per_second": round((counters.env_steps - before.env_steps) / seconds, 1) if seconds else None,
            "steps_to_50_success": counters.steps_to_50_success,
            "steps_to_90_success": counters.steps_to_90_success,
            "evaluation": summarise(evaluation.episodes) if evaluation else None,
            "policy_sha256": policy_sha256(learned.stages.model),
            "restarts": counters.restarts + counters.resumes,
            "player_restarts": counters.restarts,
            "resumes": counters.resumes,
            "exchange_share": exchange,
        }
    )
    with doing("Drawing the learning curve"):
        from trainer.runs.figures import save_learning_curve  # Matplotlib would be half a second of the run's start

        save_learning_curve(folder.read_progress(), _title(config), folder.learning_curve)
    if evaluation is None:
        Terminal().print(f"Stopped at {counters.env_steps:,} steps and saved; go on with --resume.")
    else:
        _show_evaluation(config, folder, evaluation)
        export = config.algo != "ddpg"  # whose actor is no network from observations to actions alone
        Terminal().print(next_steps(folder, replay=is_corridor(evaluation.behavior), export=export))


def evaluate_run(
    config: RunConfig,
    folder: RunFolder,
    draft: Draft,
    connection: ConnectionOptions,
    *,
    episodes: int,
    checkpoint: str | None = None,
) -> None:
    """Evaluates a checkpoint, the newest if none is named, on the episodes that the run's own evaluation played.

    Raises:
        TrainerError: There is no such checkpoint, it does not fit, or the player failed.
    """
    read = folder.read_checkpoint(config, checkpoint)  # before a player is started, or waited for
    if is_of_scene(read):
        evaluate_scene_run(config, folder, draft, connection, episodes, read)
        return
    evaluation = play_episodes(config, folder, draft, connection, episodes=episodes, checkpoint=checkpoint)
    with written(folder.path):
        _save_evaluation(config, RunFolder(draft.path), evaluation)
    draft.publish()
    _show_evaluation(config, folder, evaluation)


def play_episodes(
    config: RunConfig,
    folder: RunFolder,
    draft: Draft,
    connection: ConnectionOptions,
    *,
    episodes: int,
    checkpoint: str | None = None,
) -> Trajectories:
    """Plays a checkpoint, the newest if none is named, on the episodes that the run's own evaluation played.

    Raises:
        TrainerError: There is no such checkpoint, it does not fit, or the player failed.
    """
    folder.read_checkpoint(config, checkpoint)  # before a player is started, or waited for
    logs = PlayerLogs(RunFolder(draft.path).evaluation_logs, stay=False)
    with _evaluation_players(config, logs, connection, RestartLimits()) as players:
        stages = build_stages(config, players)
        counters = load_trained(config, folder, stages, checkpoint)
        draft.publish()
        logs.folder, logs.stay = folder.evaluation_logs, True
        played = _play(stages, players, episodes)
    return Trajectories(players.behavior, evaluation_seed(config.seed), counters.env_steps, played)


@contextmanager
def _written_to(folder: RunFolder) -> Iterator[None]:
    """Turns a full disk, or a folder that can't be written, into one sentence; other errors are not the folder's."""
    try:
        yield
    except OSError as error:
        named = error.filename is not None
        if not (_is_inside(folder, error.filename) if named else error.errno in DISK_ERRORS):
            raise
        kept = [path.name for path in checkpoints(folder.checkpoints)]
        known = (
            f"the last checkpoint is {kept[-1]}: put it right and go on with --resume." if kept else "nothing is saved."
        )
        raise TrainerError(f"{folder.path} can't be written ({error.strerror or error}); {known}") from error


def _is_inside(folder: RunFolder, name: object) -> bool:
    return Path(str(name)).absolute().is_relative_to(folder.path.absolute())


def _check_penalty(config: RunConfig, behaviors: Collection[str], checkpoint: Checkpoint | None) -> None:
    """Refuses a penalty where there is no corridor to subtract it."""
    if checkpoint is None and config.penalty != DEFAULT_PENALTY and not any(map(is_corridor, behaviors)):
        raise TrainerError(
            f"--penalty {config.penalty:g} is for a corridor, but behavior {', '.join(behaviors)} has rewards of its "
            "own; leave it out."
        )


def _check_intrinsic(config: RunConfig, behaviors: Collection[str]) -> None:
    """Refuses ``--intrinsic rnd`` where nobody learns from it."""
    signals = [config.settings_for(name).reward_signals for name in behaviors]
    if config.curiosity.intrinsic == "rnd" and not any(each.rnd for each in signals):
        raise TrainerError(
            f"--intrinsic rnd has no effect on {', '.join(behaviors)} without a strength; give one with --c, or a "
            "reward signal rnd in a CONFIG.yaml."
        )


def _say_who_came(asked: int, came: int) -> None:
    """One line for players that have another number of agents than areas were asked for."""
    hint = "; a scene makes copies of its area with a TrainingAreaReplicator (docs/unity.md)" if came < asked else ""
    text = f"Areas asked for: {asked} per player (--num-areas); agents that came, and are trained with: {came}{hint}."
    Terminal().print(text)


def _evaluation_players(
    config: RunConfig, logs: PlayerLogs, connection: ConnectionOptions, limits: RestartLimits
) -> AbstractContextManager[Players]:
    return opened(open_slots(config, logs, connection, seed=evaluation_seed(config.seed), limits=limits), config)


def _save_evaluation(config: RunConfig, folder: RunFolder, evaluation: Trajectories) -> None:
    episodes = evaluation.episodes
    save_trajectories(folder.trajectories, evaluation)
    if is_corridor(evaluation.behavior):
        shown = next((episode for episode in episodes if episode.succeeded), episodes[0])
        corridor = corridor_of(config.penalty, config.environment_parameters)
        with doing("Drawing an episode"):
            from trainer.runs.figures import save_episode_paths

            save_episode_paths(shown, _title(config), folder.episode_paths, corridor)


def _show_evaluation(config: RunConfig, folder: RunFolder, evaluation: Trajectories) -> None:
    console, episodes = Terminal(), evaluation.episodes
    console.print(f"Evaluation of {_title(config)}, deterministic policy:")
    table = Table("measure", "value")
    for name, value in summarise(episodes).items():
        if name != "success_unknown":  # which stands in the success rate's place
            table.add_row(name, _reported(episodes, name) if value is None else f"{value:g}")
    console.print(table, soft_wrap=False)
    console.print(f"Results: {folder.shown}")


def _reported(episodes: list[Episode], measure: str) -> str:
    """What stands in the place of a measure that has no value."""
    unknown = unreported(episodes, measure)
    if measure == "mean_success_length" and not unreported(episodes, "success_rate"):
        return "no successes"
    return f"unknown for {unknown} of {len(episodes)}" if 0 < unknown < len(episodes) else "not reported"


def _title(config: RunConfig) -> str:
    return f"{config.run_id} (c = {config.curiosity.c:g}, seed {config.seed})"

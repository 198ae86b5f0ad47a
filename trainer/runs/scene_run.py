"""A run on whatever a scene has: learned, evaluated, and written down for every behavior."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rich.table import Table

from trainer.activity import doing
from trainer.config import ConnectionOptions, RestartLimits, RunConfig
from trainer.curriculum import Curricula
from trainer.drafts import Draft
from trainer.errors import TrainerError
from trainer.learning.algorithm_state import weights_sha256
from trainer.players.failures import PlayerLogs
from trainer.players.location import can_be_launched
from trainer.players.opening import open_players
from trainer.players.scene import Scene
from trainer.runs.behavior_learners import BehaviorLearners
from trainer.runs.checkpoint import Checkpoint
from trainer.runs.counters import Counters
from trainer.runs.folder import RunFolder
from trainer.runs.next_steps import next_steps
from trainer.runs.opened_players import opened
from trainer.runs.scene_evaluation import PlayedEpisode, evaluate_scene, summarise_scene
from trainer.runs.scene_training import SceneTraining
from trainer.seeds import evaluation_seed
from trainer.terminal import Terminal

Played = dict[str, list[PlayedEpisode]]


@dataclass(frozen=True)
class LearnedScene:
    """What learning leaves.

    Attributes:
        finished: Whether every behavior took all its steps.
        training: With the learners.
        counters: Of the whole run.
        before: Of its earlier parts.
        played: The evaluation by players that can't be launched anew; None if there is one to come, or none at all.
    """

    finished: bool
    training: SceneTraining
    counters: Counters
    before: Counters
    played: Played | None


def learn_scene(
    config: RunConfig,
    folder: RunFolder,
    scene: Scene,
    counters: Counters,
    curricula: Curricula,
    begin: Callable[[int], None],
    checkpoint: Checkpoint | None,
    episodes: int,
) -> LearnedScene:
    """Trains every behavior of a scene.

    Args:
        config: The run.
        folder: Where its results go.
        scene: Its players.
        counters: Of the checkpoint, or new ones.
        curricula: In the lessons with which the players were opened.
        begin: Called before anything is written, with the number of agents that the first player has at first.
        checkpoint: Of a resumed run.
        episodes: Of the evaluation.

    Raises:
        TrainerError: A player failed, does not fit, or numbers went bad; what was learned until then is saved.
    """
    before = replace(counters)
    training = SceneTraining(config, folder, scene, counters, curricula, checkpoint)
    finished = training.train(begin)
    played = None
    if finished and not can_be_launched(config.env):
        played = _play(training.learners, scene, episodes)
    return LearnedScene(finished, training, counters, before, played)


def report_scene(
    config: RunConfig,
    folder: RunFolder,
    connection: ConnectionOptions,
    episodes: int,
    limits: RestartLimits,
    learned: LearnedScene,
) -> None:
    """Evaluates what was learned, and writes the run's summary and pictures.

    Raises:
        TrainerError: The player failed.
    """
    played, training = learned.played, learned.training
    if learned.finished and played is None:
        played = _play_anew(config, folder, connection, limits, episodes, training)
    _write_summary(config, folder, learned, played)
    for name, _ in training.learners:
        own = folder.behavior(name, only=training.is_only(name))
        with doing(f"Drawing {name}'s learning curve"):
            from trainer.runs.figures import save_learning_curve  # Matplotlib would be half a second of the run's start

            save_learning_curve(own.read_progress(), f"{config.run_id}: {name}", own.learning_curve)
    if played is None:
        Terminal().print(f"Stopped at {learned.counters.env_steps:,} steps and saved; go on with --resume.")
    else:
        show_played(config, folder, played)
        Terminal().print(next_steps(folder, replay=False, export=True))


def _play(learners: BehaviorLearners, scene: Scene, episodes: int) -> Played:
    each = f"Playing the evaluation's {episodes} episodes of each behavior"
    with doing(each if len(list(learners)) > 1 else f"Playing the evaluation's {episodes} episodes", episodes) as tell:
        return evaluate_scene(learners, scene, episodes, tell=tell)


def _play_anew(
    config: RunConfig,
    folder: RunFolder,
    connection: ConnectionOptions,
    limits: RestartLimits,
    episodes: int,
    training: SceneTraining,
) -> Played:
    logs = PlayerLogs(folder.evaluation_logs)
    seed, curricula = evaluation_seed(config.seed), training.curricula
    opening = open_players(config, logs, connection, seed=seed, limits=limits, curricula=curricula)
    with opened(opening, config) as players:
        assert isinstance(players, Scene)
        return _play(training.learners.on(players), players, episodes)


def is_of_scene(checkpoint: Checkpoint) -> bool:
    """Whether a checkpoint is of a run of any behaviors, and not of one in lockstep."""
    return bool(checkpoint.part("behaviors"))


def evaluate_scene_run(
    config: RunConfig,
    folder: RunFolder,
    draft: Draft,
    connection: ConnectionOptions,
    episodes: int,
    checkpoint: Checkpoint,
) -> None:
    """Plays a checkpoint on the episodes that the run's own evaluation played.

    Raises:
        TrainerError: It does not fit, or the player failed.
    """
    logs = PlayerLogs(RunFolder(draft.path).evaluation_logs, stay=False)
    curricula = Curricula(config.environment_parameters)
    curricula.load_state_dict(checkpoint.part("curricula"))
    opening = open_players(config, logs, connection, seed=evaluation_seed(config.seed), curricula=curricula)
    with opened(opening, config) as players:
        if not isinstance(players, Scene):
            raise TrainerError(
                f"The player has the corridor alone, but {config.run_id} was trained on other behaviors."
            )
        learners = BehaviorLearners(config, players)
        learners.restore(checkpoint, to_play=True)
        draft.publish()
        logs.folder, logs.stay = folder.evaluation_logs, True
        show_played(config, folder, _play(learners, players, episodes))


def _write_summary(config: RunConfig, folder: RunFolder, learned: LearnedScene, played: Played | None) -> None:
    counters, before = learned.counters, learned.before
    seconds = counters.wall_seconds - before.wall_seconds
    evaluations = summarise_scene(played or {})
    behaviors: dict[str, dict[str, Any]] = {
        name: {
            "env_steps": learner.steps,
            "episodes": learner.episodes,
            "updates": learner.updates,
            "c": learner.intrinsic_strength,
            "evaluation": evaluations.get(name),
            "policy_sha256": weights_sha256(learner.weights()),
        }
        for name, learner in learned.training.learners
    }
    only = next(iter(behaviors.values())) if len(behaviors) == 1 else None
    folder.write_summary(
        {
            **config.facts(),
            "preset": None,  # nor its curiosity had a part in it
            "c": None if only is None else only["c"],
            "env_steps": counters.env_steps,
            "episodes": counters.episodes,
            "wall_seconds": round(counters.wall_seconds, 3),
            "steps_per_second": round((counters.env_steps - before.env_steps) / seconds, 1) if seconds else None,
            "evaluation": None if only is None else only["evaluation"],
            "policy_sha256": None if only is None else only["policy_sha256"],
            "behaviors": behaviors,
            "restarts": counters.restarts + counters.resumes,
            "player_restarts": counters.restarts,
            "resumes": counters.resumes,
            "exchange_share": round(counters.exchange_seconds / counters.wall_seconds, 3) if seconds else None,
        }
    )


def show_played(config: RunConfig, folder: RunFolder, played: Played) -> None:
    """Prints an evaluation."""
    console = Terminal()
    console.print(f"Evaluation of {config.run_id} (seed {config.seed}), most likely actions:")
    table = Table("behavior", "episodes", "mean return", "mean length")
    for name, values in summarise_scene(played).items():
        cut = f" ({values['unfinished']} not ended)" if values["unfinished"] else ""
        numbers = [
            f"{values[key]:g}" if values[key] is not None else "-" for key in ("mean_return", "mean_episode_length")
        ]
        table.add_row(name, f"{values['episodes']}{cut}", *numbers)
    console.print(table, soft_wrap=False)
    console.print(f"Results: {folder.shown}")

"""Training: stages learn on players, with progress, checkpoints and a clean stop."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger

from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.learning.algorithm_state import RandomStreams
from trainer.learning.algorithms import steps_per_update
from trainer.learning.stages import Stages
from trainer.players.failures import BadNumbers
from trainer.players.slots import Slots
from trainer.runs.callbacks import CountEpisodes, CountSteps, LogRows, Save, ShowProgress, StopOnSignal
from trainer.runs.checkpoint import Checkpoint, CheckpointWriter
from trainer.runs.counters import Counters
from trainer.runs.folder import RunFolder
from trainer.runs.logs import ProgressFile, TensorBoardLog
from trainer.runs.progress import ProgressDisplay
from trainer.runs.run_state import (
    Captured,
    episode_parts,
    learning_parts,
    restore,
    restore_episodes,
    restore_trained,
    trained_parts,
)
from trainer.signals import StopSignals, deferred
from trainer.terminal import Terminal


def train(
    config: RunConfig,
    folder: RunFolder,
    stages: Stages,
    players: Slots,
    counters: Counters,
    begin: Callable[[], None],
    checkpoint: Checkpoint | None = None,
) -> bool:
    """Trains until ``config.steps``, a signal or an error; whatever ends it, the last whole update is saved.

    Args:
        config: The run.
        folder: Where its results go.
        stages: Of ``build_stages``.
        players: That the stages stand on.
        counters: Of the checkpoint, or new ones; updated as the run goes, and those of the last update at the end.
        begin: Called before anything is written, once everything is known to fit.
        checkpoint: Of a resumed run, whose players were opened with its states.

    Returns:
        Whether all steps were taken; False if a signal ended it before.

    Raises:
        TrainerError: The player failed, the folder can't be written, or numbers went bad; the last whole update is
            saved all the same.
    """
    model, steps = stages.model, steps_per_update(config)
    done = counters.env_steps
    logger = Logger(str(folder.path), [])
    model.set_logger(logger)
    episodes, random = CountEpisodes(counters), RandomStreams()
    learning = learning_parts(stages, episodes, random)
    if checkpoint is not None:
        restore_trained(checkpoint, stages, config.algo)
        restore(checkpoint, learning)
        if not restore_episodes(checkpoint, stages, players):
            Terminal().print("The player can't go on where it was: new episodes begin.")
    everything: dict[str, Captured] = {**trained_parts(stages), **learning, **episode_parts(stages), "players": players}
    begin()
    logger.output_formats += [ProgressFile(folder.progress, done), TensorBoardLog(folder.tensorboard, done)]
    writer = CheckpointWriter(folder.checkpoints)
    with ProgressDisplay() as display, StopSignals() as signals:
        display.add(config.run_id, config.steps, done)
        stop = StopOnSignal(signals)
        save = Save(everything, random, counters, config.as_dict(), stages, players, steps, stop, writer)
        callbacks = [
            CountSteps(counters, players),
            episodes,
            LogRows(counters, episodes, stages, steps * players.num_envs),
            ShowProgress(display, config.run_id, episodes, stages),
            save,
            stop,
        ]
        try:
            with _named_step(model):
                model.learn(
                    max(config.steps - done, 0),
                    callback=callbacks,
                    log_interval=None,  # type: ignore[arg-type]  # rows are LogRows', by steps and not by calls
                    reset_num_timesteps=False,
                )
        finally:
            vars(counters).update(vars(save.saved))
            with deferred():
                writer.keep()
                model.logger.close()
    return not signals.received


def load_trained(config: RunConfig, folder: RunFolder, stages: Stages, checkpoint: str | None = None) -> Counters:
    """Puts a run's policy into freshly built stages, to be played and not to be trained further.

    Args:
        config: The run, as its folder has it.
        folder: Its folder.
        stages: Of ``build_stages``.
        checkpoint: The checkpoint's name; the newest if not given.

    Returns:
        The counters that were saved with it.

    Raises:
        TrainerError: There is none, it is damaged, another run's, or does not fit.
    """
    read = folder.read_checkpoint(config, checkpoint)
    restore_trained(read, stages, config.algo)
    if stages.curiosity is not None:  # for what it makes of the episodes
        restore(read, {"curiosity": stages.curiosity})
    return Counters(**read.facts["counters"])


@contextmanager
def _named_step(model: BaseAlgorithm) -> Iterator[None]:
    """Says after which step numbers went bad."""
    try:
        yield
    except TrainerError as error:
        if isinstance(error.__cause__, BadNumbers):
            raise TrainerError(f"After step {model.num_timesteps:,}: {error}") from error
        raise

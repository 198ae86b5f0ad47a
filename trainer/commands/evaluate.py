"""``corridor evaluate``."""

import dataclasses
from dataclasses import dataclass, field

from trainer.commands.shared_options import Episodes, ExistingRun
from trainer.config import ConnectionOptions
from trainer.options import Options


@dataclass(frozen=True)
class Evaluate(Options):
    """Repeat the evaluation of a trained run."""

    results: ExistingRun
    episodes: Episodes = 200
    """How many episodes to play."""
    checkpoint: str | None = None
    """Evaluate this checkpoint, such as step-501760, not the newest; its episodes replace those of trajectories.npz."""
    env: str | None = None
    """Another environment than the run's, as in corridor train."""
    connection: ConnectionOptions = field(default_factory=ConnectionOptions)

    def run(self, typed: str) -> int:
        """Evaluates."""
        folder = self.results.find()
        from trainer.activity import doing
        from trainer.drafts import only_writer
        from trainer.players.location import check_connection, check_launchable
        from trainer.runs.checkpoint import find_checkpoint

        with only_writer(folder.path) as draft:
            config = folder.read_config()
            if self.env is not None:
                config = dataclasses.replace(config, env=self.env)
            find_checkpoint(folder.checkpoints, self.checkpoint)
            check_launchable(config.env)
            check_connection(config, self.connection)
            with doing("Loading PyTorch"):
                from trainer.runs.run import evaluate_run

            evaluate_run(config, folder, draft, self.connection, episodes=self.episodes, checkpoint=self.checkpoint)
        return 0

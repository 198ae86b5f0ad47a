"""``corridor replay``."""

from dataclasses import asdict, dataclass, field
from pathlib import Path

from trainer.commands.shared_options import Episodes, ExistingRun, OpenPage, open_page
from trainer.config import ConnectionOptions, PortOptions
from trainer.errors import TrainerError
from trainer.options import Options
from trainer.terminal import Terminal


@dataclass(frozen=True)
class Replay(Options):
    """Show a run's evaluation: a page that needs no network, a GIF and an MP4, in the run's folder.

    Of a study: its report as a page, and a replay page of each of its runs.
    """

    results: ExistingRun
    checkpoint: str | None = None
    """Play this checkpoint instead, such as step-501760."""
    episodes: Episodes = 20
    """How many episodes the page shows."""
    open: OpenPage = False
    connection: PortOptions = field(default_factory=PortOptions)

    def run(self, typed: str) -> int:
        """Writes the pages."""
        from trainer.activity import doing
        from trainer.drafts import only_writer
        from trainer.runs.folder import is_study, run_places

        for study in run_places(self.results.run, self.results.results_dir):
            if is_study(study):
                if self.checkpoint is not None:
                    raise TrainerError(
                        f"--checkpoint {self.checkpoint} is a run's, but {study} is a study; replay one of its runs."
                    )
                from trainer.viewer.study_page import write_study_page

                with only_writer(study):
                    report = write_study_page(study, self.episodes, Terminal())
                self._open(report)
                return 0
        folder, connection = self.results.find(), ConnectionOptions(**asdict(self.connection))
        with only_writer(folder.path) as draft:
            config = folder.read_config()
            if self.checkpoint is not None or not folder.trajectories.exists():
                from trainer.players.location import check_connection, check_launchable
                from trainer.runs.checkpoint import find_checkpoint

                find_checkpoint(folder.checkpoints, self.checkpoint)
                check_launchable(config.env)
                check_connection(config, connection)
            with doing("Getting ready to draw"):
                from trainer.viewer.replay_files import replay_run

            page, *_ = replay_run(
                config,
                folder,
                draft,
                connection,
                checkpoint=self.checkpoint,
                episodes=self.episodes,
            )
        self._open(page)
        return 0

    def _open(self, page: Path) -> None:
        if self.open:
            open_page(page.absolute().as_uri())

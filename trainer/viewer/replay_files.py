"""What ``corridor replay`` does: a run's evaluation as a page, a GIF and an MP4."""

from pathlib import Path

from trainer.activity import doing
from trainer.config import ConnectionOptions, RunConfig
from trainer.drafts import Draft
from trainer.errors import TrainerError
from trainer.runs.folder import RunFolder
from trainer.runs.trajectories import Trajectories, load_trajectories
from trainer.terminal import Terminal
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.document import page
from trainer.viewer.pictures import save_animations


def replay_run(
    config: RunConfig,
    folder: RunFolder,
    draft: Draft,
    connection: ConnectionOptions,
    *,
    checkpoint: str | None,
    episodes: int,
) -> list[Path]:
    """Writes ``replay.html``, ``replay.gif`` and ``replay.mp4`` into the run's folder.

    Args:
        config: The run.
        folder: Its results.
        draft: Of the folder.
        connection: How a player is reached, if one is needed.
        checkpoint: Play this checkpoint (``step-501760``) instead of showing the run's evaluation; its files are named
            after it.
        episodes: How many the page shows.

    Returns:
        The files.

    Raises:
        TrainerError: There is nothing to show, or its file is broken.
    """
    console = Terminal()
    trajectories = _trajectories(config, folder, draft, connection, checkpoint, episodes, console)
    with doing("Going through the episodes again"):
        scene = run_scene(config, trajectories, episodes)
    for note in scene["notes"]:
        console.print(note)
    name = "replay" if checkpoint is None else f"replay-step-{trajectories.env_steps}"
    html, gif, mp4 = (draft.path / f"{name}.{ending}" for ending in ("html", "gif", "mp4"))
    try:
        html.write_text(page({"mode": "replay", "scene": scene}), encoding="utf-8")
        save_animations(trajectories, scene, gif, mp4)
        draft.publish()
    except OSError as error:
        raise TrainerError(f"{folder.path} can't be written to ({error.strerror}); check its permissions.") from error
    files = [folder.path / path.name for path in (html, gif, mp4)]
    for path in files:
        console.print(f"{path} ({path.stat().st_size / 1e6:.2f} MB)")
    return files


def _trajectories(
    config: RunConfig,
    folder: RunFolder,
    draft: Draft,
    connection: ConnectionOptions,
    checkpoint: str | None,
    episodes: int,
    console: Terminal,
) -> Trajectories:
    if checkpoint is None and folder.trajectories.exists():
        return load_trajectories(folder.trajectories)
    if checkpoint is None:
        console.print("This run has no evaluation; its newest checkpoint is played.")
    with doing("Loading PyTorch"):
        from trainer.runs.run import play_episodes
    return play_episodes(config, folder, draft, connection, episodes=episodes, checkpoint=checkpoint)

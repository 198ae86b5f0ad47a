"""A study's report as a page: claims, figures, and every curve's runs with their replays."""

import base64
import os
import re
from pathlib import Path
from typing import Any

from corridor_server.shared.given import Range, read_json, shown
from trainer.activity import doing
from trainer.drafts import only_writer, written
from trainer.errors import TrainerError
from trainer.files import write_whole
from trainer.options import is_name
from trainer.runs.folder import CLAIMS, RunFolder
from trainer.runs.trajectories import load_trajectories
from trainer.terminal import Terminal
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.document import page

SEED, SEEDS = Range(0, 2**31 - 1), Range(1, 10_000)
CLAIM_KEYS = ("id", "statement", "measure", "holds", "evidence")


def write_study_page(folder: Path, episodes: int, console: Terminal) -> Path:
    """Writes ``report.html`` into a study's folder, and ``replay.html`` into that of each of its evaluated runs.

    Args:
        folder: With ``claims.json``, figures, and runs named ``<arm>-seed<N>`` (here or in a folder beside this one,
            where studies share runs).
        episodes: How many each replay shows.
        console: Told what is missing, and the file.

    Raises:
        TrainerError: ``claims.json`` is broken, or the folder can't be written to.
    """
    try:
        record = read_json((folder / CLAIMS).read_bytes())
        arms = record["arms"]
        claims = [{key: claim[key] for key in CLAIM_KEYS} for claim in record["claims"]]
        first, count = SEED.read(record["first_seed"], whole=True), SEEDS.read(record["seeds"], whole=True)
        if first is None or count is None:
            raise ValueError("its seeds are no numbers of a study")
        seeds = range(int(first), int(first + count))
        facts = [record["command"], f"{record['seeds']} seeds", f"{record['steps']:,} steps per run"]
        groups, written_pages = [], 0
        with doing("Writing the pages of runs", len(arms) * len(seeds)) as tell:
            for arm in arms:
                groups.append({"name": arm["label"], "runs": []})
                for seed in seeds:
                    groups[-1]["runs"].append(_run(folder, f"{arm['name']}-seed{seed}", episodes))
                    tell(written_pages := written_pages + 1)
    except (ValueError, KeyError, TypeError) as error:
        raise TrainerError(f"{folder / CLAIMS} is broken ({error!r}); run 'corridor study' again.") from error
    except OSError as error:
        raise TrainerError(f"{folder} can't be used ({error}); check its permissions.") from error
    without = [run["run_id"] for group in groups for run in group["runs"] if run["replay"] is None]
    notes = [f"There is no evaluation of {', '.join(without)}, so no replay."] if without else []
    figures = [{"title": _title(path), "source": _inline(path)} for path in sorted(folder.glob("*.png"))]
    study = {
        "title": record.get("study", folder.name),
        "facts": facts,
        "claims": [
            {key: claim[key] for key in ("id", "statement", "measure", "holds", "evidence")} for claim in claims
        ],
        "figures": figures,
        "groups": groups,
        "notes": notes,
    }
    report = folder / "report.html"
    with written(folder):
        write_whole(report, page({"mode": "study", "study": study}))
    for note in notes:
        console.print(note)
    console.print(f"{report} ({report.stat().st_size / 1e6:.2f} MB)")
    return report


def _run(study: Path, run_id: str, episodes: int) -> dict[str, Any]:
    """A run's line in the report; its replay is written here."""
    if not is_name(run_id):
        raise ValueError(f"{shown(run_id)} is no run id")
    places = [study / run_id, *sorted(study.parent.glob(f"*/{run_id}"))]
    folder = next((RunFolder(path) for path in places if (path / "configuration.yaml").is_file()), None)
    if folder is None or not folder.trajectories.is_file():
        return {"run_id": run_id, "facts": "", "replay": None}
    scene = run_scene(folder.read_config(), load_trajectories(folder.trajectories), episodes)
    replay = folder.path / "replay.html"
    with only_writer(folder.path):
        write_whole(replay, page({"mode": "replay", "scene": scene}))
    evaluation = read_json(folder.summary.read_bytes())["evaluation"]
    success = evaluation["success_rate"]
    facts = [
        "success unknown" if success is None else f"success {100 * success:.0f}%",
        f"return {evaluation['mean_return']:.2f}",
        f"{evaluation['mean_episode_length']:.0f} decisions per episode",
    ]
    return {"run_id": run_id, "facts": ", ".join(facts), "replay": Path(os.path.relpath(replay, study)).as_posix()}


def _title(path: Path) -> str:
    return re.sub(r"^figure(\w+)$", r"Fig. \1", path.stem).replace("-", " ")


def _inline(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"

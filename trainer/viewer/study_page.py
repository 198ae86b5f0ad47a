"""A study's report as a page: claims, figures, and every curve's runs with their replays."""

import base64
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

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
FINITE = Range()
CLAIM_KEYS = ("id", "statement", "measure", "holds", "evidence")
REPORT = "report.html"
SHOWN = 8  # runs that are named where something is missing
# Of an arm in claims.json: what the results table shows if an arm has it.
MEASURES = (
    "success_rate",
    "mean_return",
    "mean_episode_length",
    "mean_success_length",
    "opponent_contact_rate",
    "wall_contact_rate",
    "steps_to_50_success",
    "steps_to_90_success",
)
LINES = "Thick: interquartile mean over seeds; band: its 95% bootstrap interval; thin: single runs."
FIGURE_5 = "Blue: c = 0.3; red: c = 0.1; green: c = 0.5; purple: base PPO. " + LINES
FIGURE_6 = "Blue: c = 0.3 with the penalty; red: without it; green: base PPO without it. " + LINES
DOSE = "Lines: interquartile means over seeds with 95% bootstrap intervals; dots: single runs."
# What the paper's figures show, in our words, and how to read ours.
CAPTIONS = {
    "figure5a": "The paper's Fig. 5a has the external reward during training for four curiosity ratios. There, base "
    "PPO never completes the task, c = 0.3 and c = 0.1 do about equally well, and with c = 0.5 curiosity overwhelms "
    "the external reward. Here, the same quantity of our runs. " + FIGURE_5,
    "figure5b": "The paper's Fig. 5b has the steps in an episode of the same trainings. There, the agent with c = 0.3 "
    "completes the task in slightly fewer steps than with c = 0.1, and the one with c = 0.5 ends its episodes early, "
    "for the new observations that follow a reset. Here, the same quantity of our runs. " + FIGURE_5,
    "figure6a": "The paper's Fig. 6a has the external reward during training with and without the penalty of 1 for a "
    "failed episode, beside base PPO without curiosity or penalty. There, the agent with the penalty begins lower, and "
    "finds the better solution; base PPO finds none. Here, the same quantity of our runs. " + FIGURE_6,
    "figure6b": "The paper's Fig. 6b has the steps in an episode of the same trainings. There, the agent with the "
    "penalty ends with shorter episodes than the one without. Here, the same quantity of our runs. " + FIGURE_6,
    "dose-c": "Success and episode length of the evaluation against the curiosity ratio. " + DOSE,
    "dose-gamma": "Success and episode length of the evaluation against the discount factor. " + DOSE,
}


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
        results = [_result(arm) for arm in arms]
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
    notes = []
    if without:
        more = f" and {len(without) - SHOWN} more" if len(without) > SHOWN else ""
        notes = [f"There is no evaluation on a corridor of {', '.join(without[:SHOWN])}{more}, so no replay."]
    study = {
        "title": record.get("study", folder.name),
        "facts": facts,
        "claims": claims,
        "results": results,
        "figures": [_figure(path, of_the_paper=bool(claims)) for path in sorted(folder.glob("*.png"))],
        "groups": groups,
        "notes": notes,
    }
    report = folder / REPORT
    with written(folder):
        write_whole(report, page({"mode": "study", "study": study}))
    for note in notes:
        console.print(note)
    console.print(f"{report} ({report.stat().st_size / 1e6:.2f} MB)")
    return report


def _run(study: Path, run_id: str, episodes: int) -> dict[str, Any]:
    """A run's row in the report; its replay is written here. The link to it has the way back in it."""
    if not is_name(run_id):
        raise ValueError(f"{shown(run_id)} is no run id")
    places = [study / run_id, *sorted(study.parent.glob(f"*/{run_id}"))]
    folder = next((RunFolder(path) for path in places if (path / "configuration.yaml").is_file()), None)
    if folder is None or not folder.trajectories.is_file():
        return {"run_id": run_id, "evaluation": None, "replay": None}
    scene = run_scene(folder.read_config(), load_trajectories(folder.trajectories), episodes)
    replay = folder.path / "replay.html"
    with only_writer(folder.path):
        write_whole(replay, page({"mode": "replay", "scene": scene}))
    evaluation = read_json(folder.summary.read_bytes())["evaluation"]
    back = quote(_path(study / REPORT, folder.path), safe="")
    return {
        "run_id": run_id,
        "evaluation": {name: FINITE.read(evaluation.get(name)) for name in MEASURES[:6]},
        "replay": f"{quote(_path(replay, study))}?from={back}",
    }


def _path(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file, folder)).as_posix()


def _result(arm: Mapping[str, Any]) -> dict[str, Any]:
    """An arm's row of the results table: its label, how many runs, and [value, low, high] or null of each measure."""
    measures: dict[str, list[float | None] | None] = {}
    for name in MEASURES:
        if name in arm:
            found = arm[name]
            measures[name] = None if found is None else [FINITE.read(found[key]) for key in ("value", "low", "high")]
    return {"label": arm["label"], "runs": FINITE.read(arm.get("runs")), "measures": measures}


def _figure(path: Path, of_the_paper: bool) -> dict[str, str]:
    title = re.sub(r"^figure(\w+)$", r"Fig. \1", path.stem).replace("-", " ")
    source = f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
    caption = CAPTIONS.get(path.stem, LINES)
    if path.stem.startswith("figure5") and not of_the_paper:  # curiosity on an environment of others
        title, caption = "Return" if path.stem.endswith("a") else "Episode length", FIGURE_5
    return {"title": title, "caption": caption, "source": source}

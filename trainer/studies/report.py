"""What a study leaves to read: ``report.md``, ``claims.json``, ``runs.csv`` and figures, and the same in a terminal."""

import csv
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from trainer.studies import plots
from trainer.studies.bootstrap import Estimate, interval
from trainer.studies.claims import BOOTSTRAP_SEED, CLAIMS, MINIMUM
from trainer.studies.executors import RunOutcome
from trainer.studies.plan import Study, World
from trainer.studies.results import RunResult, scores, steps_to
from trainer.terminal import Terminal

CURVE_COLUMNS = (
    "env_steps",
    "episodes",
    "mean_return",
    "mean_episode_length",
    "success_rate",
    "intrinsic_reward",
    "curiosity_return",
)
# Columns of the results table: (title, measure, digits, factor).
COLUMNS = (
    ("success", "success_rate", 3, 1.0),
    ("return", "mean_return", 2, 1.0),
    ("episode length", "mean_episode_length", 0, 1.0),
    ("length of successes", "mean_success_length", 0, 1.0),
    ("opponent contact", "opponent_contact_rate", 2, 1.0),
    ("wall contact", "wall_contact_rate", 2, 1.0),
    ("thousand steps to 50%", "steps_to_50_success", 0, 1e-3),
    ("thousand steps to 90%", "steps_to_90_success", 0, 1e-3),
    ("minutes of learning", "wall_seconds", 1, 1 / 60),
)
IN_TERMINAL = ("success_rate", "mean_return", "mean_episode_length", "wall_contact_rate", "steps_to_50_success")
# What every environment has; the rest is a corridor's.
ANYWHERE = ("mean_return", "mean_episode_length", "wall_seconds")
VERDICTS = {True: Text("yes", "green"), False: Text("no", "red"), None: Text("not decided", "yellow")}


@dataclass(frozen=True)
class Facts:
    """What was done, and with what.

    Attributes:
        command: As it was typed.
        world: What the runs were trained on.
        seeds: The runs' seeds.
        steps: Agent steps per run.
        trained: Runs that this invocation trained; the others were finished before.
        wall_seconds: That it took.
        versions: By package.
        machine: What kind of machine it was.
    """

    command: str
    world: World
    seeds: Sequence[int]
    steps: int
    trained: int
    wall_seconds: float
    versions: Mapping[str, str]
    machine: Mapping[str, Any]


@dataclass(frozen=True)
class Report:
    """A study's results.

    Attributes:
        study: What was planned.
        runs: Finished runs by arm name, in the seeds' order.
        failures: Runs that failed.
        facts: How it was done.
    """

    study: Study
    runs: Mapping[str, Sequence[RunResult]]
    failures: Sequence[RunOutcome]
    facts: Facts

    def claims(self) -> list[dict[str, Any]]:
        """The study's claims, decided."""
        return [CLAIMS[name].judge(self.runs) for name in self.study.claims]

    def estimates(self) -> dict[str, dict[str, Estimate | None]]:
        """Of every measure by arm name; None where no run has it (for steps to a success rate: reached it)."""
        generator = np.random.default_rng(BOOTSTRAP_SEED)
        found: dict[str, dict[str, Estimate | None]] = {}
        for arm in self.study.arms:
            runs = self.runs[arm.name]
            found[arm.name] = {}
            for _, measure, _, _ in self._columns:
                values = scores(runs, measure)
                if len(values) and measure.startswith("steps_to"):
                    values = steps_to(runs, measure)
                found[arm.name][measure] = interval(values, generator) if len(values) else None
        return found

    @property
    def reports_success(self) -> bool:
        """Whether its environment says of an episode that it succeeded, as a corridor does."""
        found = [run for runs in self.runs.values() for run in runs]
        return not found or any(run.measure("success_rate") is not None for run in found)

    @property
    def _columns(self) -> Sequence[tuple[str, str, int, float]]:
        return [column for column in COLUMNS if self.reports_success or column[1] in ANYWHERE]

    def table(self, between: str, measures: Collection[str] | None = None) -> list[list[str]]:
        """The results table: its head, then a row per arm.

        Args:
            between: Stands between a number and its interval.
            measures: Which of ``COLUMNS``; all if not given. Those that the environment doesn't have are left out.
        """
        shown = [column for column in self._columns if measures is None or column[1] in measures]
        rows = [["arm", "runs", *(title for title, *_ in shown)]]
        for arm, estimates in zip(self.study.arms, self.estimates().values(), strict=True):
            runs = self.runs[arm.name]
            cells = [arm.label, str(len(runs))]
            for _, measure, digits, factor in shown:
                estimate = estimates[measure]
                cell = "no successes" if measure == "mean_success_length" and runs else "-"
                if estimate is not None:
                    value, low, high = (
                        f"{number * factor:,.{digits}f}" for number in (estimate.value, estimate.low, estimate.high)
                    )
                    cell = f"{value}{between}[{low}, {high}]"
                if measure.startswith("steps_to") and runs:
                    cell += f"{between}({len(scores(runs, measure))} of {len(runs)})"
                cells.append(cell)
            rows.append(cells)
        return rows

    def write(self, folder: Path) -> None:
        """Writes every file of the report to a folder."""
        claims = self.claims()
        self._write_runs(folder / "runs.csv")
        self._write_figures(folder)
        (folder / "claims.json").write_text(json.dumps(self._record(claims), indent=2) + "\n", encoding="utf-8")
        (folder / "report.md").write_text(self._markdown(claims), encoding="utf-8")

    def show(self, console: Terminal) -> None:
        """Prints claims, results and failures."""
        if self.study.claims:
            table = Table("claim", "holds", "evidence", title=f"{self.study.title}", show_lines=True)
            for claim in self.claims():
                table.add_row(f"{claim['id']} {claim['statement']}", VERDICTS[claim["holds"]], claim["evidence"])
            console.print(table, soft_wrap=False)
        head, *rows = self.table("\n", IN_TERMINAL)
        table = Table(*head, show_lines=True, title="Interquartile means over seeds, with 95% intervals")
        for row in rows:
            table.add_row(*row)
        console.print(table, soft_wrap=False)
        for failure in self.failures:
            console.print_failure("failed:", _failure(failure))

    def _record(self, claims: list[dict[str, Any]]) -> dict[str, Any]:
        return {
            "study": self.study.name,
            "claims": claims,
            "arms": self._arms(),
            "seeds": len(self.facts.seeds),
            "first_seed": self.facts.seeds[0],
            "steps": self.facts.steps,
            "preset": self.facts.world.preset,
            "command": self.facts.command,
            "runs": {
                "finished": sum(len(runs) for runs in self.runs.values()),
                "trained_by_this_command": self.facts.trained,
                "failed": [failure.run_id for failure in self.failures],
            },
            "wall_seconds": round(self.facts.wall_seconds, 1),
            "training_seconds": round(self._training_seconds(), 1),
            "versions": dict(self.facts.versions),
            "machine": dict(self.facts.machine),
        }

    def _arms(self) -> list[dict[str, Any]]:
        rows = []
        for arm, estimates in zip(self.study.arms, self.estimates().values(), strict=True):
            measures = {name: None if value is None else asdict(value) for name, value in estimates.items()}
            rows.append({"name": arm.name, "label": arm.label, "runs": len(self.runs[arm.name]), **measures})
        return rows

    def _training_seconds(self) -> float:
        return sum(run.measure("wall_seconds") or 0.0 for runs in self.runs.values() for run in runs)

    def _write_runs(self, path: Path) -> None:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["run_id", "arm", "algo", "intrinsic", "c", "penalty", "gamma", "seed", *CURVE_COLUMNS])
            for arm in self.study.arms:
                for run in self.runs[arm.name]:
                    config = run.config
                    curiosity = config.curiosity
                    fixed = [config.run_id, arm.name, config.algo, curiosity.intrinsic, curiosity.c, config.penalty]
                    fixed += [config.ppo.gamma, config.seed]
                    for row in run.rows:
                        writer.writerow([*fixed, *(row[column] for column in CURVE_COLUMNS)])

    def _write_figures(self, folder: Path) -> None:
        labels = {arm.name: arm.label for arm in self.study.arms}
        for spec in self.study.figures:
            for letter, column, title, unit in plots.PANELS:
                generator = np.random.default_rng(BOOTSTRAP_SEED)
                figure = plots.learning_curves(self.runs, spec.colours, labels, column, title, unit, generator)
                plots.save(figure, folder / f"{spec.name}{letter}.png")
        for dose in self.study.doses:
            figure = plots.dose_response(self.runs, dose, np.random.default_rng(BOOTSTRAP_SEED))
            plots.save(figure, folder / f"{dose.name}.png")

    def _markdown(self, claims: list[dict[str, Any]]) -> str:
        sections = [self._headline(), self._claims_section(claims), self._results_section(), *self._figure_sections()]
        sections += [self._runs_section(), self._origin()]
        return "\n\n".join("\n".join(section) for section in sections if section) + "\n"

    def _headline(self) -> list[str]:
        facts = self.facts
        finished = sum(len(runs) for runs in self.runs.values())
        planned = len(self.study.arms) * len(facts.seeds)
        first, count = facts.seeds[0], len(facts.seeds)
        seeds = f"seed {first}" if count == 1 else f"{count} seeds from {first} on"
        return [
            f"# {self.study.title}",
            "",
            f"`{facts.command}`",
            "",
            f"{finished} of {planned} runs finished: {seeds}, "
            f"{len(self.study.arms)} arms, {facts.steps:,} agent steps per run, {facts.world.name}. This command "
            f"trained {facts.trained} of them in {_duration(facts.wall_seconds)}; learning took "
            f"{_duration(self._training_seconds())} over all runs.",
        ]

    def _claims_section(self, claims: list[dict[str, Any]]) -> list[str]:
        if not claims:
            return []
        rows = [["", "claim", "holds", "evidence"]]
        for claim in claims:
            verdict = {True: "yes", False: "**no**", None: "not decided"}[claim["holds"]]
            rows.append([claim["id"], claim["statement"], verdict, claim["evidence"]])
        lines = ["## Claims of the paper", "", *_markdown_table(rows)]
        lines += ["", f"What decides each, fixed before the runs, where there are {MINIMUM}:", ""]
        lines += [f"- {claim['id']}: {claim['measure']}." for claim in claims]
        if any(claim["holds"] is False for claim in claims):
            lines += ["", "What a claim that does not hold depends on is what `corridor study dose-response` shows."]
        return lines

    def _results_section(self) -> list[str]:
        lines = [
            "## Results",
            "",
            "Interquartile means over seeds, with 95% stratified bootstrap intervals, of each run's evaluation at the",
            "end: deterministic policy, extrinsic reward, lengths in decisions.",
        ]
        if self.reports_success:
            lines += [
                "Steps to a success rate are those until so many of the last 100 training episodes succeeded; how many",
                "runs got there stands in parentheses, and the others count with all their steps, so that the number",
                "is a lower bound.",
            ]
        return [*lines, "", *_markdown_table(self.table(" "))]

    def _figure_sections(self) -> list[list[str]]:
        return [
            [
                f"## {spec.title}",
                "",
                *(f"![{title}]({spec.name}{letter}.png)\n" for letter, _, title, _ in plots.PANELS),
                "Thick: interquartile mean over seeds; band: its 95% bootstrap interval; thin: single runs.",
            ]
            for spec in self.study.figures
        ] + [
            [
                f"## {dose.title}",
                "",
                f"![{dose.title}]({dose.name}.png)\n",
                "Lines: interquartile means over seeds with 95% bootstrap intervals; dots: single runs.",
            ]
            for dose in self.study.doses
        ]

    def _runs_section(self) -> list[str]:
        seeds = self.facts.seeds
        what, measure = ("Success", "success_rate") if self.reports_success else ("Mean return", "mean_return")
        rows = [["arm", *map(str, seeds)]]
        for arm in self.study.arms:
            values = {run.config.seed: run.measure(measure) for run in self.runs[arm.name]}
            shown = (values.get(seed) for seed in seeds)
            rows.append([arm.label, *("-" if value is None else f"{value:.2f}" for value in shown)])
        lines = ["## Every run", "", f"{what} in the evaluation, by seed:", "", *_markdown_table(rows)]
        elsewhere = [
            f"{Path(run.path).parent.name}/{run.config.run_id}"
            for runs in self.runs.values()
            for run in runs
            if Path(run.path).parent.name != self.study.name
        ]
        if elsewhere:
            lines += ["", f"Taken from other studies in the same place: {', '.join(elsewhere)}."]
        if self.failures:
            lines += ["", "Failed:", "", *(f"- {_failure(failure)}" for failure in self.failures)]
        return lines

    def _origin(self) -> list[str]:
        machine = ", ".join(f"{name} {value}" for name, value in self.facts.machine.items())
        versions = ", ".join(f"{name} {value}" for name, value in self.facts.versions.items())
        return ["## Made with", "", f"{machine}; {versions}."]


def _markdown_table(rows: Sequence[Sequence[str]]) -> list[str]:
    head, *rest = rows
    return [f"| {' | '.join(head)} |", "|---" * len(head) + "|", *(f"| {' | '.join(row)} |" for row in rest)]


def _failure(outcome: RunOutcome) -> str:
    return f"{outcome.run_id}: {outcome.error} (log: {outcome.log})"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"

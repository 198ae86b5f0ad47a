"""What ``corridor study`` does: plans, has the missing runs executed, and reports."""

import time
from collections.abc import Sequence
from contextlib import closing

from trainer.runs.folder import machine, versions
from trainer.signals import temporary_folder
from trainer.studies.display import StudyDisplay
from trainer.studies.executors import Executor, RunOutcome, Task
from trainer.studies.plan import Study, World
from trainer.studies.report import Facts, Report
from trainer.studies.store import Store
from trainer.terminal import Terminal


def run_study(
    study: Study,
    executor: Executor,
    store: Store,
    *,
    world: World,
    seeds: Sequence[int],
    episodes: int,
    timeout_wait: int,
    command: str,
    console: Terminal,
) -> bool:
    """Trains what is not finished yet and writes the report.

    Args:
        study: What to compare.
        executor: Where runs are executed.
        store: Where runs and report go.
        world: What the runs are trained on.
        seeds: One run of every arm for each.
        episodes: Of each run's evaluation.
        timeout_wait: Seconds to wait for a player.
        command: As typed, for the report.
        console: To show progress and results.

    Returns:
        Whether every run finished.

    Raises:
        TrainerError: The place can't be written or holds something else, or there is no cluster; nothing was started.
    """
    store.check_writable()
    executor.check()
    planned = study.runs(world, seeds)
    configs = [planned[arm.name][index] for index in range(len(seeds)) for arm in study.arms]
    steps = configs[0].steps
    missing = [config for config in configs if store.find(config, study.name, episodes) is None]
    tasks = [Task(config, store.place, study.name, episodes, timeout_wait) for config in missing]
    started = time.monotonic()
    ended: list[RunOutcome] = []
    try:
        with (
            StudyDisplay(console, study.name, len(configs), len(missing), steps) as display,
            closing(executor.run(tasks)) as updates,
        ):
            for update in updates:
                ended += update.ended
                display.update(update)
    except KeyboardInterrupt:
        console.print("Finished runs are kept; the same command goes on with the others.")
        raise

    found = {name: [store.find(config, study.name, episodes) for config in arm] for name, arm in planned.items()}
    runs = {name: [store.load(path) for path in paths if path is not None] for name, paths in found.items()}
    failures = [outcome for outcome in ended if outcome.error is not None]
    facts = Facts(
        command=command,
        world=world,
        seeds=seeds,
        steps=steps,
        trained=len(ended) - len(failures),
        wall_seconds=time.monotonic() - started,
        versions=versions(),
        machine=machine(),
    )
    report = Report(study, runs, failures, facts)
    with temporary_folder() as temporary:
        report.write(temporary)
        for file in sorted(temporary.iterdir()):
            store.put(file, f"{study.name}/{file.name}")
    report.show(console)
    console.print(f"Report: {store.place}/{study.name}/report.md")
    return not failures

"""``corridor study``."""

import os
import shlex
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Self

import tyro

from corridor_server.shared.given import Range
from trainer.commands.shared_options import STUDIED, TrainingOptions
from trainer.commands.train import EnvironmentOptions, Train
from trainer.config import PAPER_STEPS, RESULTS, ExecutorName, RunConfig, WaitOptions
from trainer.errors import TrainerError
from trainer.hyperparameters import Intrinsic
from trainer.options import Count, Options
from trainer.terminal import Terminal

if TYPE_CHECKING:
    from trainer.studies.plan import Arm


@dataclass(frozen=True)
class StudyOptions(Options):
    """A study that trains."""

    name: ClassVar[str]
    only_c: ClassVar = False  # whether its arms differ in nothing else, which any environment can be trained with
    file: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[CONFIG.yaml]", help_behavior_hint="")
    ] = None
    """How runs are trained, as of corridor train, instead of by a preset; c, penalty and algorithm are each arm's."""
    seeds: Annotated[int, Range(1, 1000)] = 5
    """How many seeds; every arm has a run for each."""
    first_seed: Annotated[int, Range(0)] = 0
    """The first of them."""
    jobs: Count | None = None
    """Runs at a time on this machine; as many as it has cores if not given."""
    executor: ExecutorName = "local"
    """local: processes of this machine; ray: tasks on a Ray cluster (pip install .[ray])."""
    address: str | None = None
    """The Ray cluster, HOST:PORT or auto; if not given, one is started on this machine."""
    results_dir: str = str(RESULTS)
    """Where studies are kept: a folder, or an fsspec URL. A stopped study goes on from what is there."""
    environment: EnvironmentOptions = field(default_factory=EnvironmentOptions)
    training: TrainingOptions = field(default_factory=TrainingOptions)
    connection: WaitOptions = field(default_factory=WaitOptions)

    def __post_init__(self) -> None:
        """Refuses values out of their range, and options that contradict each other.

        Raises:
            TrainerError: The first of them.
        """
        super().__post_init__()
        if self.first_seed + self.seeds > 2**31:
            raise TrainerError(
                f"--first-seed {self.first_seed} and --seeds {self.seeds} go beyond the protocol's seeds, < {2**31}."
            )
        if self.executor == "local" and self.address is not None:
            raise TrainerError(f"--address {self.address} names a Ray cluster; add --executor ray, or leave it out.")
        if self.executor == "ray" and self.jobs is not None:
            raise TrainerError("--jobs is for --executor local; Ray runs as many at a time as its cluster has cores.")

    def with_env_args(self, given: tuple[str, ...]) -> Self:
        """The same with arguments of the players' own."""
        return replace(self, environment=replace(self.environment, env_args=given))

    def run(self, typed: str) -> int:
        """Trains what is missing and reports; the exit code is 1 if a run failed."""
        from trainer.studies.store import Store

        train = self.trained()
        store = Store(self.results_dir)
        with store.only_writer(self.name):
            from trainer.activity import doing

            with doing("Looking for runs that are finished"):
                from trainer.studies import conduct, executors, plan
                from trainer.studies.ray_executor import RayExecutor

            study = next(each for each in plan.STUDIES if each.name == self.name)
            if train is None:
                world = plan.corridor_world(self.training.preset or STUDIED, self.training.steps or PAPER_STEPS)
            else:
                world = plan.World(name_of(train), partial(run_of, train), train.training.preset)
                study = study if train.environment.env == "builtin" else study.elsewhere(world)
            begun = world.run(study.arms[0], self.first_seed).ppo.gamma
            if study.gamma not in (None, begun):
                raise TrainerError(
                    f"gamma is {begun:g} in {world.name}, but study {self.name} compares {study.gamma:g} with others; "
                    f"take a preset or a file that has it, such as --preset {STUDIED}."
                )
            executor: executors.Executor
            if self.executor == "ray":
                executor = RayExecutor(self.address)
            else:
                executor = executors.LocalExecutor(self.jobs or os.cpu_count() or 1)
            finished = conduct.run_study(
                study,
                executor,
                store,
                world=world,
                seeds=range(self.first_seed, self.first_seed + self.seeds),
                episodes=self.training.eval_episodes,
                timeout_wait=self.connection.timeout_wait,
                command=typed,
                console=Terminal(),
            )
        return 0 if finished else 1

    def trained(self) -> Train | None:
        """The command whose runs these are but for what each arm has; None for a preset's, on the corridor.

        Raises:
            TrainerError: It would be refused, or its runs can't be an arm's.
        """
        if self.file is None and self.environment == EnvironmentOptions():
            return None
        train = Train(file=self.file)
        train = train.over_its_file() or train
        given = {
            each.name: getattr(self.environment, each.name)
            for each in fields(EnvironmentOptions)
            if getattr(self.environment, each.name) != each.default
        }
        environment = replace(train.environment, **given)
        said_how = train.said is not None and bool(
            train.said.paper or train.said.behaviors or train.said.default_settings
        )
        preset = self.training.preset or (STUDIED if environment.env == "builtin" and not said_how else None)
        learning = replace(train.training, preset=preset, steps=self.training.steps)
        train = replace(train, run_id=self.name, environment=environment, training=learning)
        env = train.environment.env
        from trainer.players.location import can_be_launched, check_launchable

        check_launchable(env)
        train.check_effects(can_be_launched(env))
        if env != "builtin" and not can_be_launched(env):
            raise TrainerError(f"--env is {env}, but a study starts its players itself; give a build's path.")
        if env != "builtin" and not self.only_c:
            raise TrainerError(
                f"--env is {env}, but study {self.name} changes what only the paper's corridor has; take study "
                f"{CuriosityRatio.name}, which changes c alone."
            )
        config = train.run_config()
        if not self.only_c and (config.behaviors or config.default_settings is not None):
            raise TrainerError(
                f"{self.file} has no trainer_type paper, but study {self.name} changes what only that has; take study "
                f"{CuriosityRatio.name}, which changes c alone."
            )
        if len(config.behaviors) > 1:
            raise TrainerError(
                f"{self.file} has {len(config.behaviors)} behaviors, but a study compares runs of one; leave one."
            )
        return train


def name_of(train: Train) -> str:
    """What a report calls the runs of a command."""
    said, environment, preset = train.said, train.environment, train.training.preset
    parts = [] if said is None or said.place is None else [said.place.path.name]
    if preset is not None:
        parts.append(f"preset {preset}")
    if environment.env != "builtin":
        parts = parts or ["ML-Agents' defaults"]
        parts.append(shlex.join([Path(environment.env).name, *environment.env_args]))
    return ", ".join([*parts, *environment.env_param])


def run_of(train: Train, arm: "Arm", seed: int) -> RunConfig:
    """An arm's run, as ``corridor train`` would make it."""
    settings = [] if train.said is None else [*train.said.behaviors.values(), train.said.default_settings]
    signals = [each.reward_signals for each in settings if each is not None]
    of_file: Intrinsic = "rnd" if any(each.rnd for each in signals) else train.training.intrinsic
    learning = replace(
        train.training,
        seed=seed,
        c=arm.c,
        penalty=arm.penalty,
        algo=arm.algo,
        intrinsic=arm.intrinsic if arm.c == 0 or arm.intrinsic != "icm" else of_file,
    )
    config = replace(train, run_id=arm.run_id(seed), training=learning).run_config()
    return config if arm.gamma is None else replace(config, ppo=replace(config.ppo, gamma=arm.gamma))


@dataclass(frozen=True)
class CuriosityRatio(StudyOptions):
    """Fig. 5: c = 0, 0.1, 0.3 and 0.5; with --env on another environment, which is held against no claim."""

    name: ClassVar = "curiosity-ratio"
    only_c: ClassVar = True


@dataclass(frozen=True)
class Penalty(StudyOptions):
    """Fig. 6: c = 0.3 with and without the penalty of -1, and base PPO without either."""

    name: ClassVar = "penalty"


@dataclass(frozen=True)
class CaseStudies(StudyOptions):
    """Both of these at once; runs that both need are trained once."""

    name: ClassVar = "case-studies"


@dataclass(frozen=True)
class Algorithms(StudyOptions):
    """Section III-A: PPO, A2C, TRPO and DDPG with and without curiosity; RND beside ICM."""

    name: ClassVar = "algorithms"


@dataclass(frozen=True)
class DoseResponse(StudyOptions):
    """What the claims depend on: c from 0 to 2; gamma, with and without the penalty, with and without curiosity."""

    name: ClassVar = "dose-response"


@dataclass(frozen=True)
class Generalise(Options):
    """Trained policies in corridors that they never saw: faster opponents, narrower, switch and start moved, more."""

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...", help_behavior_hint="")]
    """Finished runs, by id or path: one, or several seeds of the same settings."""
    episodes: Count = 100
    """To play in each changed corridor."""
    results_dir: Path = RESULTS
    """Where runs are kept; the report goes to RESULTS_DIR/generalise."""
    connection: WaitOptions = field(default_factory=WaitOptions)

    def run(self, typed: str) -> int:
        """Plays and reports."""
        if not self.runs:
            raise TrainerError("Which run's policy? Give a run's id, or several: corridor study generalise RUN ...")
        from trainer.runs.checkpoint import find_checkpoint
        from trainer.runs.folder import RunFolder

        folders = [RunFolder.find(run, self.results_dir) for run in self.runs]
        for folder in folders:
            find_checkpoint(folder.checkpoints)
        from trainer.activity import doing
        from trainer.drafts import only_writer

        with doing("Loading PyTorch"):
            from trainer.studies.generalise import run_generalise

        target = self.results_dir / "generalise"
        with only_writer(target) as draft:
            run_generalise(
                folders,
                draft,
                target,
                episodes=self.episodes,
                timeout_wait=self.connection.timeout_wait,
                command=typed,
                console=Terminal(),
            )
        return 0


STUDIES: dict[str, type[StudyOptions] | type[Generalise]] = {
    "curiosity-ratio": CuriosityRatio,
    "penalty": Penalty,
    "case-studies": CaseStudies,
    "algorithms": Algorithms,
    "dose-response": DoseResponse,
    "generalise": Generalise,
}


@dataclass(frozen=True)
class StudyCommand:
    """Train many runs and report what they show, with statistics over seeds."""

    what: (
        Annotated[CuriosityRatio, tyro.conf.subcommand("curiosity-ratio")]
        | Annotated[Penalty, tyro.conf.subcommand("penalty")]
        | Annotated[CaseStudies, tyro.conf.subcommand("case-studies")]
        | Annotated[Algorithms, tyro.conf.subcommand("algorithms")]
        | Annotated[DoseResponse, tyro.conf.subcommand("dose-response")]
        | Annotated[Generalise, tyro.conf.subcommand("generalise")]
    )
    """Which study."""

    def run(self, typed: str) -> int:
        """Runs the study."""
        return self.what.run(typed)

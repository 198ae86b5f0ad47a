"""The ``corridor`` command."""

import dataclasses
import os
import shlex
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.console import Console
from rich.markup import escape

from trainer.config import (
    PAPER_STEPS,
    PRESETS,
    Algorithm,
    ConnectionOptions,
    EngineConfig,
    ExecutorName,
    Intrinsic,
    PresetName,
    RestartLimits,
    RunConfig,
    preset_run,
)
from trainer.corridor import check_ranges
from trainer.errors import TrainerError
from trainer.players.settings import engine_config, environment_parameters, read_settings
from trainer.runs.folder import RunFolder
from trainer.signals import interrupt_on_stop_signals

INTERRUPTED = 130  # what a shell reports for a program that Ctrl-C ended
ENV_ARGS = "--env-args"


@dataclass(frozen=True)
class Train:
    """Train an agent on an ML-Agents environment, then evaluate it.

    Attributes:
        run_id: Name of the run; its results go to RESULTS_DIR/RUN_ID.
        env: builtin (our corridor), editor (the Unity editor, port 5004), a build's path, or HOST:PORT to listen on.
        preset: fast: many areas through one player; paper: one area through UnityToGymWrapper, as the paper did.
        c: The paper's curiosity ratio; 0 is base PPO.
        seed: Decides the run.
        steps: Agent steps to train for.
        num_envs: Players, stepped concurrently, on consecutive ports.
        num_areas: Training areas in each player; the preset's if not given.
        base_port: Port on which the first launched player finds the trainer.
        listen: Host to listen on for players; anything but loopback trusts the network.
        timeout_wait: Seconds to wait for a player.
        results_dir: Where runs are kept.
        resume: Continue an existing run.
        force: Overwrite an existing run.
        algo: The learning algorithm.
        intrinsic: What curiosity is paid for: icm, or rnd (random network distillation).
        from_sb3: Begin with the policy of this Stable-Baselines3 .zip instead of a random one.
        penalty: Subtracted from the reward when an episode fails; 0 for the paper's case study B.
        eval_episodes: Episodes of the evaluation at the end.
        config: YAML file with engine_settings and environment_parameters, as mlagents-learn's.
        env_param: Environment parameters, NAME=NUMBER; over those of the file.
        time_scale: Unity's time scale; 20 if not given.
        width: Of Unity's window; 84 if not given.
        height: Of Unity's window; 84 if not given.
        quality_level: Unity's; 5 if not given.
        target_frame_rate: Unity's; -1, as fast as can be, if not given.
        capture_frame_rate: Unity's; 60 if not given.
        max_lifetime_restarts: How often a player that died or hung is started again; -1 is no limit.
        restarts_rate_limit_n: How often in any period; -1 is no limit.
        restarts_rate_limit_period_s: The length of the period, in seconds.
        env_args: Everything after this option is passed to the launched players.
    """

    run_id: str
    env: str = "builtin"
    preset: PresetName = "fast"
    c: float = 0.3
    seed: int = 0
    steps: int = PAPER_STEPS
    num_envs: int = 1
    num_areas: int | None = None
    base_port: int = 5005
    listen: str = "localhost"
    timeout_wait: int = 60
    results_dir: Path = Path("results")
    resume: bool = False
    force: bool = False
    algo: Algorithm = "ppo"
    intrinsic: Intrinsic = "icm"
    from_sb3: Path | None = None
    penalty: float = 1.0
    eval_episodes: int = 200
    config: Path | None = None
    env_param: tuple[str, ...] = ()
    time_scale: float | None = None
    width: int | None = None
    height: int | None = None
    quality_level: int | None = None
    target_frame_rate: int | None = None
    capture_frame_rate: int | None = None
    max_lifetime_restarts: int = 10
    restarts_rate_limit_n: int = 1
    restarts_rate_limit_period_s: float = 60.0
    env_args: tuple[str, ...] = ()

    def run_config(self) -> RunConfig:
        """The run that these arguments ask for.

        Raises:
            TrainerError: A value is out of its range.
        """
        preset = PRESETS[self.preset]
        areas = preset.num_areas if self.num_areas is None else self.num_areas
        at_least = [("steps", self.steps, 1), ("num-areas", areas, 1), ("timeout-wait", self.timeout_wait, 1)]
        at_least += [("eval-episodes", self.eval_episodes, 1), ("seed", self.seed, 0), ("base-port", self.base_port, 1)]
        at_least += [("num-envs", self.num_envs, 1)]
        for name, value, low in at_least:
            if value < low:
                raise TrainerError(f"--{name} is {value}, but a whole number from {low} up was expected.")
        if self.seed >= 2**31:
            raise TrainerError(f"--seed is {self.seed}, but the protocol carries seeds below {2**31}.")
        if self.base_port + self.num_envs - 1 > 65535:
            raise TrainerError(f"--base-port is {self.base_port}, but ports end at 65535.")
        for name, number in (("c", self.c), ("penalty", self.penalty)):
            if not 0.0 <= number <= 1000.0:
                raise TrainerError(f"--{name} is {number:g}, but a number from 0 to 1000 was expected.")
        for name, count in (("num-areas", areas), ("num-envs", self.num_envs)):
            if preset.through_gym and count != 1:
                raise TrainerError(
                    f"--{name} is {count}, but preset {self.preset} trains one area through UnityToGymWrapper; "
                    f"leave --{name} out, or take preset fast."
                )
        if self.env == "editor" and self.num_envs != 1:
            raise TrainerError(f"--num-envs is {self.num_envs}, but the Unity editor is one player; leave it out.")
        if self.algo == "ddpg" and self.resume:
            raise TrainerError("--resume can't continue --algo ddpg, whose replay buffer is not kept; begin a new run.")
        engine, parameters = read_settings(self.config)
        given = {name: value for name in EngineConfig.RANGES if (value := getattr(self, name)) is not None}
        config = preset_run(
            self.run_id,
            self.preset,
            c=self.c,
            seed=self.seed,
            steps=self.steps,
            env=self.env,
            algo=self.algo,
            penalty=self.penalty,
            num_areas=areas,
            intrinsic=self.intrinsic,
            from_sb3=None if self.from_sb3 is None else str(self.from_sb3),
            num_envs=self.num_envs,
            env_args=list(self.env_args),
            engine=engine_config({**engine, **given}),
            environment_parameters=environment_parameters(self.env_param, parameters, self.env == "builtin"),
        )
        if self.env == "builtin":
            check_ranges(config.environment_parameters)
        return config

    def restart_limits(self) -> RestartLimits:
        """How often players may be started again.

        Raises:
            TrainerError: A value is out of its range.
        """
        for name, count in (
            ("max-lifetime-restarts", self.max_lifetime_restarts),
            ("restarts-rate-limit-n", self.restarts_rate_limit_n),
        ):
            if count < -1:
                raise TrainerError(f"--{name} is {count}, but a whole number from 0 up was expected, or -1: no limit.")
        if not self.restarts_rate_limit_period_s > 0.0:
            raise TrainerError(
                f"--restarts-rate-limit-period-s is {self.restarts_rate_limit_period_s:g}, but seconds above 0 were "
                "expected."
            )
        return RestartLimits(self.max_lifetime_restarts, self.restarts_rate_limit_n, self.restarts_rate_limit_period_s)


@dataclass(frozen=True)
class Evaluate:
    """Repeat the evaluation of a trained run.

    Attributes:
        run: The run's id, or the path of its folder.
        episodes: How many episodes to play.
        env: Another environment than the run's, as in corridor train.
        base_port: Port on which a launched player finds the trainer.
        listen: Host to listen on for players; anything but loopback trusts the network.
        timeout_wait: Seconds to wait for the player.
        results_dir: Where runs are kept.
    """

    run: tyro.conf.Positional[str]
    episodes: int = 200
    env: str | None = None
    base_port: int = 5005
    listen: str = "localhost"
    timeout_wait: int = 60
    results_dir: Path = Path("results")


@dataclass(frozen=True)
class Export:
    """Write a trained run's policy as an ONNX file that Unity reads.

    Attributes:
        run: The run's id, or the path of its folder.
        onnx: The file to write.
        results_dir: Where runs are kept.
    """

    run: tyro.conf.Positional[str]
    onnx: Path
    results_dir: Path = Path("results")


@dataclass(frozen=True)
class Replay:
    """Show a run's evaluation: a page that needs no network, a GIF and an MP4, in the run's folder.

    Of a study: its report as a page, and a replay page of each of its runs.

    Attributes:
        run: The run's or study's id, or the path of its folder.
        checkpoint: Play this checkpoint instead, such as step-500736.
        episodes: How many episodes the page shows.
        base_port: Port on which a launched player finds the trainer.
        timeout_wait: Seconds to wait for the player.
        results_dir: Where runs are kept.
    """

    run: tyro.conf.Positional[str]
    checkpoint: str | None = None
    episodes: int = 20
    base_port: int = 5005
    timeout_wait: int = 60
    results_dir: Path = Path("results")


@dataclass(frozen=True)
class Watch:
    """Watch runs while they train, and drive the learner yourself, in a browser on this machine.

    Attributes:
        port: Port of the page, on loopback.
        results_dir: Where runs are kept.
    """

    port: int = 8008
    results_dir: Path = Path("results")


@dataclass(frozen=True)
class Check:
    """Hold a player against the ML-Agents protocol, and against the corridor's contract.

    Attributes:
        env: builtin, a build's path, editor, or HOST:PORT to listen on. A player that is not started here has to dial
            in again for every sentence.
        timeout_wait: Seconds to wait for each message of the player.
    """

    env: str = "builtin"
    timeout_wait: float = 20.0


@dataclass(frozen=True)
class Bench:
    """Measure exchange, training, start-up and memory on this machine.

    Attributes:
        json: Write the figures to this file.
        plot: Draw the rate against the number of areas to this PNG file.
        official: A Python interpreter that has Unity's published client (mlagents-envs 1.1.0), to be measured beside.
        base_port: The first of three ports for players.
    """

    json: Path | None = None
    plot: Path | None = None
    official: str | None = None
    base_port: int = 5005


@dataclass(frozen=True)
class StudyOptions:
    """Options of every study that trains.

    Attributes:
        seeds: How many seeds; every arm has a run for each.
        first_seed: The first of them.
        steps: Agent steps a run.
        preset: The runs' preset.
        jobs: Runs at a time on this machine; as many as it has cores if not given.
        executor: local: processes of this machine; ray: tasks on a Ray cluster (pip install .[ray]).
        address: The Ray cluster, HOST:PORT or auto; if not given, one is started on this machine.
        eval_episodes: Episodes of each run's evaluation.
        timeout_wait: Seconds to wait for a player.
        results_dir: Where studies are kept: a folder, or an fsspec URL. A stopped study goes on from what is there.
    """

    name: ClassVar[str]
    seeds: int = 5
    first_seed: int = 0
    steps: int = PAPER_STEPS
    preset: PresetName = "fast"
    jobs: int | None = None
    executor: ExecutorName = "local"
    address: str | None = None
    eval_episodes: int = 200
    timeout_wait: int = 60
    results_dir: str = "results"

    def check(self) -> None:
        """Refuses values out of their range, and options that contradict each other.

        Raises:
            TrainerError: The first of them.
        """
        at_least = [("seeds", self.seeds, 1), ("first-seed", self.first_seed, 0), ("steps", self.steps, 1)]
        at_least += [("eval-episodes", self.eval_episodes, 1), ("timeout-wait", self.timeout_wait, 1)]
        at_least += [("jobs", 1 if self.jobs is None else self.jobs, 1)]
        for name, value, low in at_least:
            if value < low:
                raise TrainerError(f"--{name} is {value}, but a whole number from {low} up was expected.")
        if self.first_seed + self.seeds > 2**31:
            raise TrainerError(
                f"--first-seed {self.first_seed} and --seeds {self.seeds} go beyond the protocol's seeds, < {2**31}."
            )
        if self.executor == "local" and self.address is not None:
            raise TrainerError(f"--address {self.address} names a Ray cluster; add --executor ray, or leave it out.")
        if self.executor == "ray" and self.jobs is not None:
            raise TrainerError("--jobs is for --executor local; Ray runs as many at a time as its cluster has cores.")


@dataclass(frozen=True)
class CuriosityRatio(StudyOptions):
    """Fig. 5: c = 0, 0.1, 0.3 and 0.5."""

    name: ClassVar = "curiosity-ratio"


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
class Generalise:
    """Trained policies in corridors that they never saw: faster opponents, narrower, switch and start moved, more.

    Attributes:
        runs: Finished runs, by id or path: one, or several seeds of the same settings.
        episodes: To play in each changed corridor.
        timeout_wait: Seconds to wait for the player.
        results_dir: Where runs are kept; the report goes to RESULTS_DIR/generalise.
    """

    runs: tyro.conf.Positional[tuple[str, ...]]
    episodes: int = 100
    timeout_wait: int = 60
    results_dir: Path = Path("results")


@dataclass(frozen=True)
class Study:
    """Train many runs and report what they show, with statistics over seeds.

    Attributes:
        what: Which study.
    """

    what: tyro.conf.OmitArgPrefixes[
        Annotated[CuriosityRatio, tyro.conf.subcommand("curiosity-ratio")]
        | Annotated[Penalty, tyro.conf.subcommand("penalty")]
        | Annotated[CaseStudies, tyro.conf.subcommand("case-studies")]
        | Annotated[Algorithms, tyro.conf.subcommand("algorithms")]
        | Annotated[DoseResponse, tyro.conf.subcommand("dose-response")]
        | Annotated[Generalise, tyro.conf.subcommand("generalise")]
    ]


Command = (
    Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Study, tyro.conf.subcommand("study")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Watch, tyro.conf.subcommand("watch")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the process's exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    env_args = []
    if ENV_ARGS in arguments:  # what follows is the player's, dashes and all, as with mlagents-learn
        at = arguments.index(ENV_ARGS)
        arguments, env_args = arguments[:at], arguments[at + 1 :]
    command = tyro.cli(Command, prog="corridor", args=arguments, config=(tyro.conf.FlagCreatePairsOff,))
    if env_args and isinstance(command, Train):
        command = dataclasses.replace(command, env_args=tuple(env_args))
    console = Console(stderr=True)
    interrupt_on_stop_signals()
    try:
        return _run(command, shlex.join(["corridor", *arguments]))
    except TrainerError as error:
        console.print(f"[bold red]error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        return 1
    except KeyboardInterrupt:
        console.print("Stopped.")
        return INTERRUPTED


def _run(command: Train | Evaluate | Export | Study | Replay | Watch | Check | Bench, typed: str) -> int:
    if isinstance(command, Study):
        if isinstance(command.what, Generalise):
            return _generalise(command.what, typed)
        return _study(command.what, typed)
    if isinstance(command, Bench):
        from trainer.bench.measure import run_bench

        run_bench(command.json, command.plot, command.official, command.base_port, Console())
        return 0
    if isinstance(command, Check):
        from trainer.conformance.checker import check_player

        return 0 if check_player(command.env, command.timeout_wait, Console()) else 1
    if isinstance(command, Watch):
        from trainer.viewer.page_server import watch

        watch(command.results_dir, command.port, Console())
        return 0
    if isinstance(command, Train):
        config, limits = command.run_config(), command.restart_limits()
        from trainer.players.location import check_launchable

        check_launchable(config.env)  # a bad player or file is refused before a folder is made
        if command.from_sb3 is not None and not command.resume:
            from trainer.learning.sb3_zip import read_sb3_policy

            read_sb3_policy(command.from_sb3)
        folder = RunFolder.prepare(config, command.results_dir, resume=command.resume, force=command.force)
        from trainer.runs import run  # torch takes seconds to import, and an error before it should not

        finished = run.train_run(
            config,
            folder,
            ConnectionOptions(command.base_port, command.listen, command.timeout_wait),
            episodes=command.eval_episodes,
            resumed=command.resume,
            limits=limits,
        )
        return 0 if finished else INTERRUPTED
    if isinstance(command, Replay):
        return _replay(command)
    folder = RunFolder.find(command.run, command.results_dir)
    config = folder.read_config()
    if isinstance(command, Export):
        from trainer.runs.onnx_file import export_run

        export_run(config, folder, command.onnx)
        Console().print(f"Wrote {command.onnx}", highlight=False, soft_wrap=True)
        return 0
    if command.env is not None:
        config = dataclasses.replace(config, env=command.env)
    if command.episodes < 1:
        raise TrainerError(f"--episodes is {command.episodes}, but 1 or more was expected.")
    from trainer.runs import run

    run.evaluate_run(
        config,
        folder,
        ConnectionOptions(command.base_port, command.listen, command.timeout_wait),
        episodes=command.episodes,
    )
    return 0


def _study(options: StudyOptions, typed: str) -> int:
    options.check()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # stop as for Ctrl-C
    from trainer.studies import conduct, executors, plan
    from trainer.studies.ray_executor import RayExecutor
    from trainer.studies.store import Store

    studies = {each.name: each for each in plan.STUDIES}
    executor: executors.Executor
    if options.executor == "ray":
        executor = RayExecutor(options.address)
    else:
        executor = executors.LocalExecutor(options.jobs or os.cpu_count() or 1)
    finished = conduct.run_study(
        studies[options.name],
        executor,
        Store(options.results_dir),
        preset=options.preset,
        seeds=range(options.first_seed, options.first_seed + options.seeds),
        steps=options.steps,
        episodes=options.eval_episodes,
        timeout_wait=options.timeout_wait,
        command=typed,
        console=Console(),
    )
    return 0 if finished else 1


def _generalise(options: Generalise, typed: str) -> int:
    if not options.runs:
        raise TrainerError("Which run's policy? Give a run's id, or several: corridor study generalise RUN ...")
    for name, value in (("episodes", options.episodes), ("timeout-wait", options.timeout_wait)):
        if value < 1:
            raise TrainerError(f"--{name} is {value}, but a whole number from 1 up was expected.")
    folders = [RunFolder.find(run, options.results_dir) for run in options.runs]
    from trainer.studies.generalise import run_generalise

    run_generalise(
        folders,
        options.results_dir / "generalise",
        episodes=options.episodes,
        timeout_wait=options.timeout_wait,
        command=typed,
        console=Console(),
    )
    return 0


def _replay(command: Replay) -> int:
    if command.episodes < 1:
        raise TrainerError(f"--episodes is {command.episodes}, but 1 or more was expected.")
    from trainer.viewer.replay_files import replay_run
    from trainer.viewer.study_page import is_study, write_study_page

    for study in (command.results_dir / command.run, Path(command.run)):
        if is_study(study):
            write_study_page(study, command.episodes, Console())
            return 0
    folder = RunFolder.find(command.run, command.results_dir)
    replay_run(
        folder.read_config(),
        folder,
        ConnectionOptions(base_port=command.base_port, timeout_wait=command.timeout_wait),
        checkpoint=command.checkpoint,
        episodes=command.episodes,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())

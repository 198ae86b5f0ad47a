"""``corridor train``."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, TypedDict, cast, get_type_hints

import tyro

from corridor_server.shared.given import Range
from trainer.commands.shared_options import PRESET, Flag, ResultsDir, TrainingOptions
from trainer.config import PAPER_STEPS, RESULTS, ConnectionOptions, Device, EngineConfig, RestartLimits, RunConfig
from trainer.corridor import DEFAULT_PENALTY, check_ranges
from trainer.errors import TrainerError
from trainer.hyperparameters import Algorithm, Intrinsic
from trainer.options import Count, Options, Seed, env_args_of_another
from trainer.paper_settings import PaperSettings
from trainer.presets import CURIOSITY_RATIO, PRESETS, preset_run
from trainer.run_options import RunOptions
from trainer.signals import INTERRUPTED


def _no_effect(option: str, value: object) -> TrainerError:
    return TrainerError(
        f"{option} {value} has no effect on behaviors that a file has settings for; leave it out, or the file's "
        "behaviors and default_settings."
    )


def _flags_of(config: type[EngineConfig]) -> Any:
    """A config's fields as flags; what is not typed is left out of their mapping, so that the file's value stands."""
    types, make_dict = get_type_hints(config), cast(Any, TypedDict)  # mypy wants a class statement of it
    flags = {
        each.name: Annotated[types[each.name], tyro.conf.arg(help_behavior_hint=f"(default: {each.default})")]
        for each in fields(config)
    }
    made = make_dict(f"{config.__name__}Flags", flags, total=False)
    made.__doc__ = config.__doc__
    return made


@dataclass(frozen=True)
class EnvironmentOptions(Options):
    """What is trained on. A player is the process that plays it: a Unity build, or corridor-server."""

    env: Annotated[str, tyro.conf.arg(metavar="WHICH")] = "builtin"
    """builtin (the paper's corridor), editor (Unity's, port 5004), a build's path, or HOST:PORT to listen on."""
    num_envs: Count = 1
    """How many players play at the same time, on ports that follow each other."""
    num_areas: Annotated[
        Count | None, tyro.conf.arg(help_behavior_hint="(default: the preset's, or 1 where a file says how to train)")
    ] = None
    """Copies of the training area in each player, with an agent each."""
    env_param: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=NUMBER ...", help_behavior_hint="")] = ()
    """Numbers that the environment can be told, such as opponent_speed=1.5; over those of the file."""
    graphics: Flag = False
    """Builds that are launched here open a window and render, which a scene with a camera needs."""
    no_graphics: Flag = False
    """They render nothing and need no display: the default here, where mlagents-learn renders."""
    env_args: Annotated[tuple[str, ...], tyro.conf.arg(metavar="...", help_behavior_hint="")] = ()
    """Everything after this option is passed to the players that are launched here."""


@dataclass(frozen=True)
class LearningOptions(TrainingOptions):
    """How, and how long, the agent learns."""

    seed: Seed = 0
    """The same seed gives the same run."""
    c: Annotated[
        float | None,
        Range(0, 1000),
        tyro.conf.arg(help_behavior_hint="(default: the preset's 0.3, or what the file says)"),
    ] = None
    """How much curiosity counts beside the environment's reward (the paper's curiosity ratio); 0 is none: base PPO."""
    penalty: Annotated[float, Range(0, 1000)] = DEFAULT_PENALTY
    """Subtracted from the reward when an episode fails; 0 for the paper's case study B."""
    intrinsic: Intrinsic = "icm"
    """What curiosity is paid for: icm, being wrong about what an action will change (the paper's intrinsic curiosity
    module); rnd, being wrong about what a random network says of it (random network distillation)."""
    algo: Algorithm = "ppo"
    """How the policy is improved: by PPO (proximal policy optimisation), as in the paper, or by another algorithm."""
    from_sb3: Annotated[Path | None, tyro.conf.arg(metavar="MODEL.zip", help_behavior_hint="")] = None
    """Begin with the policy that Stable-Baselines3 saved in this file, not with a random one."""
    device: Device = "auto"
    """Where networks compute; auto: a GPU where PyTorch sees one, if it is worth it."""


@dataclass(frozen=True)
class Train(Options):
    """Train an agent on an ML-Agents environment, then evaluate it."""

    run_id: Annotated[
        str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(required, here or in the file)")
    ] = None
    """Name of the run; its results go to RESULTS_DIR/NAME."""
    file: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[CONFIG.yaml]", help_behavior_hint="")
    ] = None
    """A file of settings, as mlagents-learn has it; options win over it, and it over the preset."""
    results_dir: ResultsDir = RESULTS
    resume: Flag = False
    """Continue the run of this name."""
    force: Flag = False
    """Delete the run of this name, and begin again."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="CONFIG.yaml", help_behavior_hint="")] = None
    """Another way to give the file."""
    environment: EnvironmentOptions = field(default_factory=EnvironmentOptions)
    training: LearningOptions = field(default_factory=LearningOptions)
    connection: ConnectionOptions = field(default_factory=ConnectionOptions)
    restarts: RestartLimits = field(default_factory=RestartLimits)
    engine: Annotated[Mapping[str, float], tyro.conf.arg(constructor=_flags_of(EngineConfig))] = field(
        default_factory=dict
    )
    said: Annotated[RunOptions | None, tyro.conf.Fixed, tyro.conf.Suppress] = None
    """What the file says, once it has been read and flags stand over it."""

    def __post_init__(self) -> None:
        """Refuses values out of their range, and options that contradict each other.

        Raises:
            TrainerError: The first of them.
        """
        super().__post_init__()
        base_port, preset = self.connection.base_port, self.training.preset or PRESET
        environment, training = self.environment, self.training
        if self.file is not None and self.config is not None:
            raise TrainerError(f"{self.file} and --config {self.config} are two files; give one of them.")
        if base_port + environment.num_envs - 1 > 65535:
            raise TrainerError(f"--base-port is {base_port}, but ports end at 65535.")
        through_gym = PRESETS[preset].through_gym if self._paper is None else self._paper.through_gym
        for name, count in (("num-areas", environment.num_areas), ("num-envs", environment.num_envs)):
            if through_gym and count not in (None, 1):
                raise TrainerError(
                    f"--{name} is {count}, but preset {preset} trains one area through UnityToGymWrapper; "
                    f"leave --{name} out, or take preset fast."
                )
        if environment.env == "editor" and environment.num_envs != 1:
            raise TrainerError(
                f"--num-envs is {environment.num_envs}, but the Unity editor is one player; leave it out."
            )
        try:
            str(self.results_dir).encode()
        except UnicodeEncodeError as error:
            raise TrainerError(f"--results-dir {self.results_dir} is not UTF-8, as TensorBoard needs it.") from error
        if environment.graphics and environment.no_graphics:
            raise TrainerError("--graphics and --no-graphics contradict each other; give one of them.")
        if training.c == 0 and training.intrinsic != "icm":
            raise TrainerError(f"--intrinsic {training.intrinsic} has no effect with --c 0, base PPO; leave it out.")

    def with_env_args(self, given: tuple[str, ...]) -> "Train":
        """The same with arguments of the players' own."""
        return replace(self, environment=replace(self.environment, env_args=given))

    def over_its_file(self) -> "Train | None":
        """A command whose values are those of this one's file, where it has any, for flags to stand over.

        Returns:
            The command; None without a file.

        Raises:
            TrainerError: The file can't be used.
        """
        said = self._read()
        if said is None:
            return None
        env, checkpoints = said.env_settings.as_dict(), said.checkpoint_settings.as_dict()
        connection, restarts = ("timeout_wait", "base_port"), [each.name for each in fields(RestartLimits)]
        values: dict[str, Any] = {name: env[name] for name in ("num_envs", "num_areas") if name in env}
        if "env_path" in env:
            values["env"] = env["env_path"]
        learning: dict[str, Any] = {"seed": env.get("seed", 0), "device": said.torch_settings.device or "auto"}
        if said.paper is not None:
            settings = said.paper.settings
            learning |= {"algo": settings.algorithm, "penalty": settings.penalty}
            learning["intrinsic"] = settings.curiosity.intrinsic
            learning["from_sb3"] = None if settings.from_sb3 is None else Path(settings.from_sb3)
        return Train(
            said=said,
            run_id=checkpoints.get("run_id"),
            results_dir=Path(checkpoints.get("results_dir", RESULTS)),
            environment=EnvironmentOptions(env_args=tuple(env.get("env_args", ())), **values),
            training=LearningOptions(**learning),
            connection=ConnectionOptions(**{name: env[name] for name in connection if name in env}),
            restarts=RestartLimits(**{name: env[name] for name in restarts if name in env}),
        )

    @property
    def _paper(self) -> PaperSettings | None:
        return None if self.said is None or self.said.paper is None else self.said.paper.settings

    def _read(self) -> RunOptions | None:
        path = self.config if self.file is None else self.file
        return None if path is None else RunOptions.read(path)

    def resumes_or_overwrites(self) -> tuple[bool, bool]:
        """Whether an existing run is continued, and whether it is overwritten: by flags, else by the file."""
        if self.resume or self.force or self.said is None:
            return self.resume, self.force
        return bool(self.said.checkpoint_settings.resume), bool(self.said.checkpoint_settings.force)

    def run_config(self) -> RunConfig:
        """The run that these options ask for.

        Raises:
            TrainerError: There is no run id, the file can't be used, or an environment parameter can't be set.
        """
        if self.run_id is None:
            raise TrainerError("The run has no name; give it one with --run-id.")
        environment, training = self.environment, self.training
        said, ours, paper = self.said or self._read() or RunOptions(), environment.env == "builtin", self._paper
        engine: dict[str, Any] = dict(self.engine)
        behaviors, default, unlisted = said.recorded(training.steps, training.c, training.intrinsic)
        by_behavior = bool(behaviors) or default is not None
        if by_behavior:
            self._check_lockstep()
        if paper is not None and training.preset is not None:
            raise _no_effect("--preset", training.preset)
        c = CURIOSITY_RATIO if paper is None else paper.curiosity.c
        renders = bool(said.graphics) and not environment.no_graphics and self._is_build()
        config = preset_run(
            self.run_id,
            (training.preset or PRESET) if paper is None else paper.preset,
            c=c if training.c is None else training.c,
            seed=training.seed,
            steps=training.steps or said.max_steps or PAPER_STEPS,
            env=environment.env,
            algo=training.algo,
            penalty=training.penalty,
            num_areas=1 if environment.num_areas is None and by_behavior else environment.num_areas,
            intrinsic=training.intrinsic,
            from_sb3=None if training.from_sb3 is None else str(training.from_sb3),
            num_envs=environment.num_envs,
            env_args=list(environment.env_args),
            graphics=environment.graphics or renders,
            engine=EngineConfig(**{**said.engine_settings, **engine}),
            environment_parameters=said.parameters(environment.env_param, ours),
            base=None if paper is None else paper.base,
            own=paper.own_hyperparameters if paper is not None and paper.algorithm == training.algo else None,
            behavior=None if said.paper is None else said.paper.behavior,
            preset_given=training.preset is not None or paper is not None,
            behaviors=behaviors,
            default_settings=default,
            unlisted_settings={} if ours or paper is not None else unlisted,  # the corridor has its preset
            device=training.device,
        )
        if ours:
            check_ranges(config.environment_parameters)
        return config

    def _check_lockstep(self) -> None:
        """Refuses what only runs in lockstep have.

        Raises:
            TrainerError: The first of them.
        """
        algo = None if self.training.algo == "ppo" else self.training.algo
        for option, value in (
            ("--preset", self.training.preset),
            ("--algo", algo),
            ("--from-sb3", self.training.from_sb3),
        ):
            if value is not None:
                raise _no_effect(option, value)

    def _is_build(self) -> bool:
        from trainer.players.location import can_be_launched

        return self.environment.env != "builtin" and can_be_launched(self.environment.env)

    def check_effects(self, launched: bool) -> None:
        """Refuses options that have no effect on such players.

        Args:
            launched: Whether the players are launched here.

        Raises:
            TrainerError: The first of them.
        """
        ours = self.environment.env == "builtin"
        if self.environment.env_args and not launched:
            raise env_args_of_another(self.environment.env)
        if self.environment.graphics and (ours or not launched):
            why = "draws nothing" if ours else "is not launched here"
            raise TrainerError(
                f"--graphics is for builds that are launched here, but --env {self.environment.env} {why}."
            )
        if self.engine and ours:
            name = next(iter(self.engine)).replace("_", "-")
            raise TrainerError(f"--{name} is for Unity's engine, but --env builtin has none; leave it out.")

    def run(self, typed: str) -> int:
        """Trains and evaluates."""
        config = self.run_config()
        from trainer.learning.device import check_device
        from trainer.players.location import can_be_launched, check_connection, check_launchable

        check_launchable(config.env)  # a bad player is refused before a folder is made
        self.check_effects(can_be_launched(config.env))
        check_connection(config, self.connection)
        check_device(config.device)
        resume, force = self.resumes_or_overwrites()
        if self.training.algo == "ddpg" and resume:
            raise TrainerError("--resume can't continue --algo ddpg, whose replay buffer is not kept; begin a new run.")
        from trainer.activity import doing
        from trainer.runs.folder import RunFolder

        with RunFolder.claim(config, self.results_dir, resume=resume, force=force) as (folder, draft):
            if self.training.from_sb3 is not None and not resume:
                from trainer.learning.sb3_zip import read_sb3_policy

                read_sb3_policy(self.training.from_sb3)
            with doing("Loading PyTorch"):
                from trainer.runs.run import train_run

            finished = train_run(
                config,
                folder,
                draft,
                self.connection,
                episodes=self.training.eval_episodes,
                resumed=resume,
                limits=self.restarts,
            )
        return 0 if finished else INTERRUPTED

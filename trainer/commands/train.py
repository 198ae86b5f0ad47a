"""``corridor train``."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, TypedDict, cast, get_type_hints

import tyro

from corridor_server.shared.given import Range
from trainer.commands.shared_options import PRESET, RESULTS, ResultsDir, TrainingOptions
from trainer.config import PAPER_STEPS, ConnectionOptions, Device, EngineConfig, RestartLimits, RunConfig
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
class Train(Options):
    """Train an agent on an ML-Agents environment, then evaluate it."""

    run_id: Annotated[str | None, tyro.conf.arg(help_behavior_hint="(required, here or in the file)")] = None
    """Name of the run; its results go to RESULTS_DIR/RUN_ID."""
    file: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[CONFIG.yaml]", help_behavior_hint="")
    ] = None
    """mlagents-learn's YAML; flags win over it, and it over the preset."""
    env: str = "builtin"
    """builtin (our corridor), editor (the Unity editor, port 5004), a build's path, or HOST:PORT to listen on."""
    c: Annotated[
        float | None, Range(0, 1000), tyro.conf.arg(help_behavior_hint="(default: 0.3 on the corridor, none elsewhere)")
    ] = None
    """The paper's curiosity ratio, elsewhere the strength of curiosity; 0 is base PPO."""
    seed: Seed = 0
    """Decides the run."""
    num_envs: Count = 1
    """Players, stepped concurrently, on consecutive ports."""
    num_areas: Count | None = None
    """Training areas in each player; if not given, the preset's, or 1 where a file has settings for behaviors."""
    results_dir: ResultsDir = RESULTS
    resume: bool = False
    """Continue an existing run."""
    force: bool = False
    """Overwrite an existing run."""
    algo: Algorithm = "ppo"
    """The learning algorithm."""
    intrinsic: Intrinsic = "icm"
    """What curiosity is paid for: icm, or rnd (random network distillation)."""
    from_sb3: Path | None = None
    """Begin with the policy of this Stable-Baselines3 .zip instead of a random one."""
    penalty: Annotated[float, Range(0, 1000)] = DEFAULT_PENALTY
    """Subtracted from the reward when an episode fails; 0 for the paper's case study B."""
    config: Path | None = None
    """Another way to give CONFIG.yaml."""
    device: Device = "auto"
    """Where networks compute; auto: a GPU where PyTorch sees one."""
    graphics: bool = False
    """Launched builds open a window and render, which a scene with a camera needs."""
    no_graphics: bool = False
    """Launched builds render nothing and need no display; the default here, where mlagents-learn renders."""
    env_param: tuple[str, ...] = ()
    """Environment parameters, NAME=NUMBER; over those of the file."""
    env_args: tuple[str, ...] = ()
    """Everything after this option is passed to the launched players."""
    training: TrainingOptions = field(default_factory=TrainingOptions)
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
        if self.file is not None and self.config is not None:
            raise TrainerError(f"{self.file} and --config {self.config} are two files; give one of them.")
        if base_port + self.num_envs - 1 > 65535:
            raise TrainerError(f"--base-port is {base_port}, but ports end at 65535.")
        through_gym = PRESETS[preset].through_gym if self._paper is None else self._paper.through_gym
        for name, count in (("num-areas", self.num_areas), ("num-envs", self.num_envs)):
            if through_gym and count not in (None, 1):
                raise TrainerError(
                    f"--{name} is {count}, but preset {preset} trains one area through UnityToGymWrapper; "
                    f"leave --{name} out, or take preset fast."
                )
        if self.env == "editor" and self.num_envs != 1:
            raise TrainerError(f"--num-envs is {self.num_envs}, but the Unity editor is one player; leave it out.")
        try:
            str(self.results_dir).encode()
        except UnicodeEncodeError as error:
            raise TrainerError(f"--results-dir {self.results_dir} is not UTF-8, as TensorBoard needs it.") from error
        if self.graphics and self.no_graphics:
            raise TrainerError("--graphics and --no-graphics contradict each other; give one of them.")
        if self.c == 0 and self.intrinsic != "icm":
            raise TrainerError(f"--intrinsic {self.intrinsic} has no effect with --c 0, base PPO; leave it out.")

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
        values: dict[str, Any] = {name: env[name] for name in ("num_envs", "num_areas", "seed") if name in env}
        if "env_path" in env:
            values["env"] = env["env_path"]
        if "results_dir" in checkpoints:
            values["results_dir"] = Path(checkpoints["results_dir"])
        if said.paper is not None:
            settings = said.paper.settings
            values |= {"algo": settings.algorithm, "penalty": settings.penalty}
            values["intrinsic"] = settings.curiosity.intrinsic
            values["from_sb3"] = None if settings.from_sb3 is None else Path(settings.from_sb3)
        return Train(
            said=said,
            run_id=checkpoints.get("run_id"),
            device=said.torch_settings.device or "auto",
            env_args=tuple(env.get("env_args", ())),
            connection=ConnectionOptions(**{name: env[name] for name in connection if name in env}),
            restarts=RestartLimits(**{name: env[name] for name in restarts if name in env}),
            **values,
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
        said, ours = self.said or self._read() or RunOptions(), self.env == "builtin"
        engine: dict[str, Any] = dict(self.engine)
        behaviors, default, unlisted = said.recorded(self.training.steps, self.c, self.intrinsic)
        if behaviors or default is not None:
            self._check_lockstep()
        paper = self._paper
        if paper is not None and self.training.preset is not None:
            raise _no_effect("--preset", self.training.preset)
        config = preset_run(
            self.run_id,
            (self.training.preset or PRESET) if paper is None else paper.preset,
            c=self.c if self.c is not None else (CURIOSITY_RATIO if paper is None else paper.curiosity.c),
            seed=self.seed,
            steps=self.training.steps or said.max_steps or PAPER_STEPS,
            env=self.env,
            algo=self.algo,
            penalty=self.penalty,
            num_areas=1 if self.num_areas is None and (behaviors or default is not None) else self.num_areas,
            intrinsic=self.intrinsic,
            from_sb3=None if self.from_sb3 is None else str(self.from_sb3),
            num_envs=self.num_envs,
            env_args=list(self.env_args),
            graphics=self.graphics or (bool(said.graphics) and not self.no_graphics and self._is_build()),
            engine=EngineConfig(**{**said.engine_settings, **engine}),
            environment_parameters=said.parameters(self.env_param, ours),
            base=None if paper is None else paper.base,
            own=paper.own_hyperparameters if paper is not None and paper.algorithm == self.algo else None,
            behavior=None if said.paper is None else said.paper.behavior,
            preset_given=self.training.preset is not None or paper is not None,
            behaviors=behaviors,
            default_settings=default,
            unlisted_settings={} if ours or paper is not None else unlisted,  # the corridor has its preset
            device=self.device,
        )
        if ours:
            check_ranges(config.environment_parameters)
        return config

    def _check_lockstep(self) -> None:
        """Refuses what only runs in lockstep have.

        Raises:
            TrainerError: The first of them.
        """
        algo = None if self.algo == "ppo" else self.algo
        for option, value in (("--preset", self.training.preset), ("--algo", algo), ("--from-sb3", self.from_sb3)):
            if value is not None:
                raise _no_effect(option, value)

    def _is_build(self) -> bool:
        from trainer.players.location import can_be_launched

        return self.env != "builtin" and can_be_launched(self.env)

    def check_effects(self, launched: bool) -> None:
        """Refuses options that have no effect on such players.

        Args:
            launched: Whether the players are launched here.

        Raises:
            TrainerError: The first of them.
        """
        ours = self.env == "builtin"
        if self.env_args and not launched:
            raise env_args_of_another(self.env)
        if self.graphics and (ours or not launched):
            why = "draws nothing" if ours else "is not launched here"
            raise TrainerError(f"--graphics is for builds that are launched here, but --env {self.env} {why}.")
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
        if self.algo == "ddpg" and resume:
            raise TrainerError("--resume can't continue --algo ddpg, whose replay buffer is not kept; begin a new run.")
        from trainer.runs.folder import RunFolder

        with RunFolder.claim(config, self.results_dir, resume=resume, force=force) as (folder, draft):
            if self.from_sb3 is not None and not resume:
                from trainer.learning.sb3_zip import read_sb3_policy

                read_sb3_policy(self.from_sb3)
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

"""Everything that decides a run: presets, hyperparameters, and the record that ``configuration.yaml`` keeps."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from corridor_server.shared.addresses import LOOPBACK, parse_host
from corridor_server.shared.given import Range, shown
from trainer.behavior_settings import BehaviorSettings
from trainer.corridor import check_areas
from trainer.curriculum import Curricula
from trainer.errors import TrainerError
from trainer.hyperparameters import OTHERS, Algorithm, CuriosityConfig, OtherConfig, PPOConfig
from trainer.listed_behaviors import check_behaviors, read_behaviors, settings_for
from trainer.options import (
    NAME_BYTES,
    Count,
    Options,
    Port,
    Ratio,
    Seconds,
    Seed,
    Settings,
    Steps,
    is_name,
)

PAPER_STEPS = 1_500_000
RESULTS = Path("results")  # where runs are kept unless told otherwise
BASE_PORT = 5005  # mlagents-learn's
EDITOR_TIME_SCALE = 100  # the most that the Unity editor takes
PresetName = Literal["fast", "case-studies", "threshold", "paper"]
ExecutorName = Literal["local", "ray"]
Device = Literal["auto", "cpu", "cuda"]
Restarts = Annotated[int, Range(-1, otherwise="a whole number from 0 up was expected, or -1: no limit")]


@dataclass(frozen=True)
class EngineConfig(Settings):
    """Unity's engine settings, with the defaults of mlagents-learn; our corridor has no engine and ignores them.

    Attributes:
        width: Of Unity's window, in pixels.
        height: Of Unity's window, in pixels.
        quality_level: Unity's quality level.
        time_scale: Unity's time scale: simulated seconds in a second, where the machine keeps up; never below 1, and
            in the editor not above 100.
        target_frame_rate: Unity's target frame rate; -1 is as fast as can be.
        capture_frame_rate: Unity's capture frame rate.
    """

    SECTION: ClassVar = "engine_settings"
    NO_EFFECT: ClassVar = {"no_graphics": bool}  # for an engine; a build is launched accordingly
    NOT_HERE: ClassVar = {"no_graphics_monitor": "either all players render or none; take no_graphics_monitor out"}
    width: Annotated[int, Range(1, 16384)] = 84
    height: Annotated[int, Range(1, 16384)] = 84
    quality_level: Annotated[int, Range(0, 100)] = 5
    time_scale: Annotated[float, Range(1, 1000)] = 20.0  # ML-Agents raises less to 1
    target_frame_rate: Annotated[int, Range(-1, 10000)] = -1
    capture_frame_rate: Annotated[int, Range(0, 10000)] = 60

    @classmethod
    def recorded(cls, values: dict[str, Any]) -> "EngineConfig":
        """The settings of a run; of before, it could have a time scale below 1, of which Unity made 1."""
        scale = Range().read(values.get("time_scale"))
        return cls(**({**values, "time_scale": 1.0} if scale is not None and scale < 1.0 else values))

    def _given(self, name: str, value: Any) -> str:
        return f"The engine setting {name} is {shown(value)}"


@dataclass(frozen=True)
class RestartLimits(Options):
    """How often one player may be started again after it died or hung; as with mlagents-learn, -1 means no limit."""

    max_lifetime_restarts: Restarts = 10
    """In the whole run."""
    restarts_rate_limit_n: Restarts = 1
    """In any period."""
    restarts_rate_limit_period_s: Seconds = 60.0
    """The period's length, in seconds."""


@dataclass(frozen=True)
class WaitOptions(Options):
    """Where players and trainer meet."""

    timeout_wait: Count = 60
    """Seconds to wait for a player."""


@dataclass(frozen=True)
class PortOptions(WaitOptions):
    """Where players and trainer meet."""

    base_port: Port = BASE_PORT
    """Port on which the first launched player finds the trainer; others have the ports after it."""


@dataclass(frozen=True)
class ConnectionOptions(PortOptions):
    """Where players and trainer meet."""

    listen: str = LOOPBACK
    """Host to listen on for players; anything but loopback trusts the network."""

    def __post_init__(self) -> None:
        """Refuses values out of their range, and a host that is none.

        Raises:
            TrainerError: The first of them.
        """
        super().__post_init__()
        try:
            object.__setattr__(self, "listen", parse_host(self.listen))
        except ValueError as error:
            raise TrainerError(f"--listen can't be used: {error}") from error


@dataclass(frozen=True)
class RunConfig(Settings):
    """One training run. With the same versions and machine, it decides every number of the run.

    Attributes:
        run_id: Name of the run and its folder.
        env: ``builtin``, ``editor``, a build's path, or ``HOST:PORT``.
        preset: The preset that the rest began as.
        algo: The learning algorithm.
        seed: Seeds the player, the networks, the actions and the minibatches.
        penalty: Subtracted when an episode fails (the environment parameter ``failure_penalty``).
        steps: Agent steps to train for.
        num_areas: Training areas in each player.
        through_gym: One area through ``UnityToGymWrapper``, as the paper, instead of all in lockstep.
        ppo: Hyperparameters.
        curiosity: Hyperparameters; c = 0 is base PPO without any curiosity module.
        other: Hyperparameters of an algorithm other than PPO.
        from_sb3: A Stable-Baselines3 ``.zip`` whose policy the run begins with.
        num_envs: Players, stepped concurrently.
        env_args: A launched player's own arguments.
        graphics: Whether a launched build opens a window and renders.
        engine: Unity's engine settings.
        environment_parameters: Names and values, samplers or curricula, in the form of ``mlagents-learn``'s YAML.
        preset_parameters: Those of them that nobody gave: the preset's corridor, which is for a corridor alone.
        preset_given: Whether the preset was asked for; if not, behaviors' settings may stand in its place.
        behaviors: How each behavior is trained, by its name without its team, in the form of that YAML.
        default_settings: The same of those that are not listed; None if there is no such section.
        unlisted_settings: The same of any behavior, where there is neither; without a preset, the corridor has its own.
        device: Where networks compute; ``auto`` is a GPU where PyTorch sees one.
        behavior: In lockstep, the behavior's name without its team, if a file has settings for it.

    Raises:
        TrainerError: A setting is of another type or out of its range, the run id is no folder's name, or the player
            would not take the time scale or the number of areas.
    """

    run_id: str
    env: str
    preset: PresetName
    algo: Algorithm
    seed: Seed
    penalty: Ratio
    steps: Steps
    num_areas: Count
    through_gym: bool
    ppo: PPOConfig
    curiosity: CuriosityConfig
    num_envs: Count = 1
    env_args: list[str] = dataclasses.field(default_factory=list)
    graphics: bool = False
    engine: EngineConfig = EngineConfig()
    environment_parameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    other: OtherConfig | None = None
    from_sb3: str | None = None
    preset_parameters: list[str] = dataclasses.field(default_factory=list, compare=False)  # it follows from the rest
    preset_given: bool = dataclasses.field(default=False, compare=False)
    behaviors: dict[str, Any] = dataclasses.field(default_factory=dict)
    default_settings: dict[str, Any] | None = None
    unlisted_settings: dict[str, Any] = dataclasses.field(default_factory=dict, compare=False)
    device: Device = "auto"
    behavior: str | None = dataclasses.field(default=None, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_name(self.run_id):
            raise TrainerError(
                f"The run id {shown(self.run_id)} can't name a folder; use letters, digits, and . _ + -, at most "
                f"{NAME_BYTES} of them."
            )
        if self.env == "builtin":
            check_areas(self.num_areas)
        if self.env == "editor" and self.engine.time_scale > EDITOR_TIME_SCALE:
            raise TrainerError(
                f"--time-scale is {self.engine.time_scale:g}, but the Unity editor takes at most {EDITOR_TIME_SCALE}; "
                "lower it, or train on a build."
            )
        read_behaviors(self.behaviors, self.default_settings)
        read_behaviors({}, self.unlisted_settings)
        Curricula(self.environment_parameters)

    def settings_for(self, behavior: str) -> BehaviorSettings:
        """How a behavior, with or without its team, is trained; see the function of that name for what is refused."""
        nothing_said = not self.behaviors and self.default_settings is None
        default = self.unlisted_settings if nothing_said else self.default_settings
        return settings_for(behavior, *read_behaviors(self.behaviors, default))

    def sections(self, found: Iterable[str]) -> dict[str, Any]:
        """The run in the form of ``mlagents-learn``'s YAML.

        Args:
            found: The environment's behaviors, with or without their teams.
        """
        names = dict.fromkeys(each.partition("?")[0] for each in found)
        default = self.default_settings if self.behaviors or self.default_settings else self.unlisted_settings
        parameters = {
            name: value for name, value in self.environment_parameters.items() if name not in self.preset_parameters
        }
        return {
            "behaviors": {name: self.settings_for(name).as_dict() for name in names},
            **({} if default is None else {"default_settings": default}),
            **self.surroundings(parameters),
        }

    def surroundings(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """The sections of that form that are about no behavior.

        Args:
            parameters: The environment's, as they are to stand there.
        """
        environment = {"env_path": self.env, "env_args": self.env_args, "num_envs": self.num_envs}
        return {
            "env_settings": {**environment, "num_areas": self.num_areas, "seed": self.seed},
            "engine_settings": {**dataclasses.asdict(self.engine), "no_graphics": not self.graphics},
            "environment_parameters": dict(parameters),
            "torch_settings": {"device": self.device},
        }

    def check_behaviors(self, found: Iterable[str]) -> list[str]:
        """Refuses an environment whose behaviors are not those that settings and lessons are for.

        Args:
            found: Its behaviors, with or without their teams.

        Returns:
            Those that are listed and may come later.

        Raises:
            TrainerError: One is not listed, or one that is listed or that a lesson waits for is not there.
        """
        names = [each.partition("?")[0] for each in found]
        late = check_behaviors(names, *read_behaviors(self.behaviors, self.default_settings))
        Curricula(self.environment_parameters).check_behaviors([*names, *late])
        return late

    def as_dict(self) -> dict[str, Any]:
        """Plain names and values, as ``from_dict`` reads them."""
        return dataclasses.asdict(self)

    def facts(self) -> dict[str, Any]:
        """What tells it from other runs in a summary or on a page."""
        names = ("run_id", "env", "preset", "algo", "seed")
        return {**{name: getattr(self, name) for name in names}, "c": self.curiosity.c, "penalty": self.penalty}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "RunConfig":
        """The inverse of ``as_dict``.

        Raises:
            TypeError: A value is missing or unknown.
            KeyError: The same.
            TrainerError: A value is of another type, or out of its range.
        """
        ppo, curiosity = PPOConfig(**values["ppo"]), CuriosityConfig(**values["curiosity"])
        engine = EngineConfig.recorded(values.get("engine", {}))
        kind = OTHERS.get(values["algo"])
        other = None if kind is None else kind(**values["other"])
        values = {"preset_given": True, **values}  # of before, every run had one
        return cls(**{**values, "ppo": ppo, "curiosity": curiosity, "engine": engine, "other": other})

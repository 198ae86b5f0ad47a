"""The YAML file of ``mlagents-learn``, as ``corridor train`` reads it.

Whatever it says is taken, or refused with the file's name and the line. ``debug`` (more of a log) is taken and left
out: it changes nothing that is learned. A seed of -1 is none, as in ML-Agents.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Self

from corridor_server.shared.given import mapping_of, read_text, shown
from trainer.behavior_settings import BehaviorSettings, CuriositySignal, RewardSignals, RNDSignal
from trainer.config import Device, EngineConfig, Restarts
from trainer.corridor import PENALTY, check_parameter
from trainer.curriculum import Curricula, read_lessons
from trainer.errors import SettingError, TrainerError
from trainer.hyperparameters import Intrinsic
from trainer.listed_behaviors import read_behaviors
from trainer.options import Count, Port, Seconds, Seed, Settings, names_and_values, nearest
from trainer.paper_settings import PaperBehavior, read_paper_behavior
from trainer.parameter_values import NUMBER, parse_parameter

SECTIONS = (
    "behaviors",
    "default_settings",
    "env_settings",
    "engine_settings",
    "environment_parameters",
    "checkpoint_settings",
    "torch_settings",
)
OF_A_RUN = ("run", "versions", "machine", "specs", "behavior", "agents_per_player")  # its record's further sections
OF_BEFORE = {  # ML-Agents 0.18
    "parameter_randomization": "samplers stand under environment_parameters",
    "curriculum": "lessons stand under environment_parameters",
    "default": "it is called default_settings",
}


@dataclass(frozen=True)
class EnvSettings(Settings):
    """Where an environment is and how many there are; None is not said.

    Attributes:
        env_path: A build's path.
        env_args: A launched build's own arguments.
        base_port: Port of the first player.
        num_envs: Players.
        num_areas: Training areas in each.
        seed: Of the run.
        timeout_wait: Seconds to wait for a player.
        max_lifetime_restarts: Of one player in the whole run.
        restarts_rate_limit_n: Of one player in any period.
        restarts_rate_limit_period_s: The period's length, in seconds.
    """

    SECTION: ClassVar = "env_settings"
    env_path: str | None = None
    env_args: list[str] | None = None
    base_port: Port | None = None
    num_envs: Count | None = None
    num_areas: Count | None = None
    seed: Seed | None = None
    timeout_wait: Count | None = None
    max_lifetime_restarts: Restarts | None = None
    restarts_rate_limit_n: Restarts | None = None
    restarts_rate_limit_period_s: Seconds | None = None

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings; a seed of -1 is none, and numbers among a build's arguments are texts.

        Raises:
            SettingError: Something in it can't be used.
        """
        given = dict(names_and_values(values, cls.SECTION))
        if given.get("seed") == -1:
            del given["seed"]
        if isinstance(given.get("env_args"), list):
            given["env_args"] = [str(each) if type(each) in (int, float) else each for each in given["env_args"]]
        return super().from_mapping(given)


@dataclass(frozen=True)
class CheckpointSettings(Settings):
    """Which run it is, and where its results go; None is not said.

    Attributes:
        run_id: The run's name.
        results_dir: Where runs are kept.
        resume: Continue an existing run.
        force: Overwrite an existing run.
    """

    SECTION: ClassVar = "checkpoint_settings"
    NO_EFFECT: ClassVar = {"train_model": bool}  # which nothing in ML-Agents reads any more
    NOT_HERE: ClassVar = {
        "initialize_from": "name the checkpoint to begin with as init_path of each behavior",
        "load_model": "write resume: true",
        "inference": "corridor evaluate plays what a run has learned",
    }
    run_id: str | None = None
    results_dir: str | None = None
    resume: bool | None = None
    force: bool | None = None


@dataclass(frozen=True)
class TorchSettings(Settings):
    """Where networks compute; None is not said.

    Attributes:
        device: As ``--device``.
    """

    SECTION: ClassVar = "torch_settings"
    device: Device | None = None

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings; ``cuda:0`` is the GPU that ``cuda`` takes.

        Raises:
            SettingError: Something in it can't be used.
        """
        given = dict(names_and_values(values, cls.SECTION))
        return super().from_mapping({**given, "device": "cuda"} if given.get("device") == "cuda:0" else given)


@dataclass(frozen=True)
class RunOptions:
    """What a file says.

    Attributes:
        behaviors: How each behavior is trained, by its name without its team, default settings included.
        default_settings: How the others are; None if the file doesn't say.
        paper: The one behavior that is trained as the paper's; None if there is none.
        env_settings: Where the environment is.
        engine_settings: Those of Unity's engine settings that the file has.
        graphics: Whether launched builds render; None if the file doesn't say.
        environment_parameters: Names and numbers, samplers or curricula.
        checkpoint_settings: Which run it is.
        torch_settings: Where networks compute.
        place: What the file is called, and its lines.
    """

    behaviors: Mapping[str, BehaviorSettings] = field(default_factory=dict)
    default_settings: BehaviorSettings | None = None
    paper: PaperBehavior | None = None
    env_settings: EnvSettings = EnvSettings()
    engine_settings: Mapping[str, Any] = field(default_factory=dict)
    graphics: bool | None = None
    environment_parameters: Mapping[str, Any] = field(default_factory=dict)
    checkpoint_settings: CheckpointSettings = CheckpointSettings()
    torch_settings: TorchSettings = TorchSettings()
    place: "LinesOfFile | None" = field(default=None, compare=False, repr=False)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Reads a file.

        Raises:
            TrainerError: It can't be read or is not YAML; or something in it can't be used, on a line that is named.
        """
        try:
            text = read_text(path)
            values = mapping_of(text, path)
        except ValueError as error:
            raise TrainerError(str(error)) from error
        place = LinesOfFile(path, text)
        try:
            place.check_names()
            return cls(**_sections(values), place=place)
        except SettingError as error:
            raise place.named(error) from error

    @property
    def max_steps(self) -> int | None:
        """The most that a listed behavior trains for, else what is the default; None if the file has neither."""
        if self.paper is not None:
            return self.paper.settings.max_steps
        settings: list[BehaviorSettings | None] = [*self.behaviors.values()]
        settings = settings or [self.default_settings]
        return max((each.max_steps for each in settings if each is not None), default=None)

    def recorded(
        self, steps: int | None, c: float | None, intrinsic: Intrinsic
    ) -> tuple[dict[str, Any], dict[str, Any] | None, dict[str, Any]]:
        """The sections ``behaviors`` and ``default_settings`` as a run records them, and what goes without both.

        Args:
            steps: Instead of every ``max_steps``; None leaves them.
            c: Strength of the intrinsic reward, 0 for none; None leaves it.
            intrinsic: Which one.
        """

        def changed(settings: BehaviorSettings) -> dict[str, Any]:
            signals = settings.reward_signals if c is None else _curious(settings.reward_signals, c, intrinsic)
            steps_or_own = settings.max_steps if steps is None else steps
            return replace(settings, max_steps=steps_or_own, reward_signals=signals).as_dict()

        behaviors = {name: changed(each) for name, each in self.behaviors.items()}
        default = None if self.default_settings is None else changed(self.default_settings)
        return behaviors, default, changed(BehaviorSettings())

    def parameters(self, texts: Sequence[str], env_is_ours: bool) -> dict[str, Any]:
        """Environment parameters of the command line (``NAME=NUMBER``) over those of the file, checked.

        Raises:
            TrainerError: A text has another form, or our corridor has no such parameter, or not with such a value.
        """
        parameters = dict(self.environment_parameters)
        for text in texts:
            name, equals, typed = text.partition("=")
            number = NUMBER.parse(typed)
            if not name or not equals or number is None:
                raise TrainerError(f"--env-param {text} is not of the form NAME=NUMBER, such as opponent_speed=1.5.")
            parameters[name] = number
        typed_names = {text.partition("=")[0] for text in texts}
        for name, value in parameters.items():
            try:
                _check_parameter(name, value, env_is_ours)
            except TrainerError as error:
                if name in typed_names:
                    raise
                raise self._named(SettingError(str(error), "environment_parameters", name)) from error
        return parameters

    def _named(self, error: SettingError) -> TrainerError:
        return error if self.place is None else self.place.named(error)


def _curious(signals: RewardSignals, c: float, intrinsic: Intrinsic) -> RewardSignals:
    """Signals with another strength of the intrinsic one: the file's, unless another is asked for or it has none."""
    if c == 0:
        if signals.extrinsic is None:
            raise TrainerError(
                "--c 0 takes out the only reward that the file has; add extrinsic to its reward_signals."
            )
        return replace(signals, curiosity=None, rnd=None)
    if intrinsic == "rnd":
        return replace(signals, rnd=replace(signals.rnd or RNDSignal(), strength=c), curiosity=None)
    if signals.rnd is not None and signals.curiosity is None:
        return replace(signals, rnd=replace(signals.rnd, strength=c))
    return replace(signals, curiosity=replace(signals.curiosity or CuriositySignal(), strength=c))


def _sections(values: Mapping[Any, Any]) -> dict[str, Any]:
    """What is in the sections of a file, as ``RunOptions`` has it."""
    given = {name: value for name, value in values.items() if value is not None}  # all its lines may be comments
    if "run" in given:
        given = {name: value for name, value in given.items() if name not in OF_A_RUN}
    for name in given:
        if name in OF_BEFORE:
            raise SettingError(f"The section {name} is of ML-Agents before 0.18; {OF_BEFORE[name]} now.", name)
        if name == "debug":
            if not isinstance(given[name], bool):
                raise SettingError(f"The setting debug is {shown(given[name])}, but true or false was expected.", name)
        elif name not in SECTIONS:
            raise SettingError(f"There is no section {shown(name)}; {nearest(name, SECTIONS)}.", name)
    of_behaviors = given.get("behaviors", {}), given.get("default_settings")
    paper = read_paper_behavior(*of_behaviors)
    behaviors, default = read_behaviors(*of_behaviors) if paper is None else ({}, None)
    made: dict[str, Any] = {"behaviors": behaviors, "default_settings": default, "paper": paper}
    kinds: dict[str, type[Settings]] = {
        "env_settings": EnvSettings,
        "checkpoint_settings": CheckpointSettings,
        "torch_settings": TorchSettings,
        "engine_settings": EngineConfig,
    }
    for name, kind in kinds.items():
        try:
            made[name] = kind.from_mapping(given.get(name, {}))
        except SettingError as error:
            raise error.within(name) from error
    typed, engine = given.get("engine_settings", {}), made["engine_settings"]
    made["engine_settings"] = {
        each.name: getattr(engine, each.name) for each in fields(EngineConfig) if each.name in typed
    }
    made["graphics"] = not typed["no_graphics"] if "no_graphics" in typed else None
    parameters = given.get("environment_parameters", {})
    try:
        Curricula(parameters)
    except SettingError as error:
        raise error.within("environment_parameters") from error
    return {**made, "environment_parameters": parameters}


def _check_parameter(name: str, value: Any, env_is_ours: bool) -> None:
    if name == PENALTY:
        raise TrainerError(f"The environment parameter {PENALTY} is set by --penalty; take it out.")
    for lesson in read_lessons(name, value):
        parsed = parse_parameter(name, lesson.value, 0)
        if env_is_ours:
            check_parameter(name, parsed)


class LinesOfFile:
    """On which line of a YAML file a setting stands.

    Args:
        path: The file's.
        text: What is in it, which PyYAML can read.

    Attributes:
        path: The same.
    """

    def __init__(self, path: Path, text: str) -> None:
        import yaml

        self.path = path
        self._root: Any = yaml.compose(text, yaml.SafeLoader)

    def named(self, error: SettingError) -> TrainerError:
        """A refusal with the file's name and the line of the setting, or of what it should stand in."""
        node, line = self._root, 1
        for step in error.where:
            found = [(at, inner) for name, at, inner in _inside(node) if name == str(step)]
            if not found:
                break
            line, node = found[0]
        return TrainerError(f"{self.path}, line {line}: {error}")

    def check_names(self) -> None:
        """Refuses a name that stands twice in one place, of which PyYAML would take the last.

        Raises:
            TrainerError: There is one.
        """
        waiting, seen = [self._root], set()
        while waiting:
            node = waiting.pop()
            if node is None or id(node) in seen:  # it may be referred to a billion times
                continue
            seen.add(id(node))
            lines: dict[str, int] = {}
            for name, line, inner in _inside(node, merge=False):
                if name in lines:
                    raise TrainerError(
                        f"{self.path}, line {line}: {shown(name)} stands on line {lines[name]} already; take one out."
                    )
                lines[name] = line
                waiting.append(inner)


def _inside(node: Any, merge: bool = True) -> Iterator[tuple[str, int, Any]]:
    """The name or index, the line, and the node of each thing in a list or mapping; merged ones (``<<``) last."""
    waiting, seen = [node], set()
    while waiting:
        node = waiting.pop(0)
        if node is None or node.id == "scalar" or id(node) in seen:
            continue
        seen.add(id(node))
        if node.id == "sequence":
            yield from ((str(index), each.start_mark.line + 1, each) for index, each in enumerate(node.value))
            continue
        for key, value in node.value:
            if not key.tag.endswith(":merge"):
                yield str(key.value), key.start_mark.line + 1, value
            elif merge:
                waiting += value.value if value.id == "sequence" else [value]

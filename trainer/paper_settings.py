"""``trainer_type: paper``, a behavior's section of the YAML file: how the paper's runs are trained, all agents in step.

``mlagents-learn`` has no such trainer. Names are those of ``config``, which are Stable-Baselines3's; a file need only
have what differs from its preset.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Self

from corridor_server.shared.given import shown
from trainer.config import PAPER_STEPS, PresetName, RunConfig
from trainer.corridor import BEHAVIOR, DEFAULT_PENALTY, is_corridor
from trainer.errors import SettingError
from trainer.hyperparameters import OTHERS, Algorithm, CuriosityConfig, OtherConfig, PPOConfig
from trainer.listed_behaviors import merged
from trainer.options import Ratio, Settings, Steps, names_and_values
from trainer.presets import CURIOSITY_RATIO, PRESETS, Preset, preset_run

PAPER = "paper"


@dataclass(frozen=True)
class PaperSettings(Settings):
    """How the one behavior of a run in lockstep is trained.

    Attributes:
        trainer_type: Always ``paper``.
        preset: What is not said is as this has it.
        algorithm: What learns the policy.
        through_gym: One area through ``UnityToGymWrapper``, instead of all agents in lockstep.
        hyperparameters: PPO's, and what other algorithms have in common with it.
        own_hyperparameters: An algorithm's other than PPO.
        curiosity: The intrinsic reward, and how its networks learn.
        penalty: As ``--penalty``.
        from_sb3: As ``--from-sb3``.
        max_steps: Agent steps to train for.
    """

    SECTION: ClassVar = "a behavior of trainer_type paper"
    trainer_type: Literal["paper"] = "paper"
    preset: PresetName = "fast"
    algorithm: Algorithm = "ppo"
    through_gym: bool = False
    hyperparameters: PPOConfig = field(default_factory=PPOConfig)
    own_hyperparameters: OtherConfig | None = None
    curiosity: CuriosityConfig = field(default_factory=CuriosityConfig)
    penalty: Ratio = DEFAULT_PENALTY
    from_sb3: str | None = None
    max_steps: Steps = PAPER_STEPS

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings, but that what is not said is the preset's.

        Raises:
            SettingError: Something in it can't be used.
        """
        given = dict(names_and_values(values, cls.SECTION))
        preset, algorithm = given.get("preset", "fast"), given.get("algorithm", "ppo")
        if preset in PRESETS:  # or it is refused
            below = PRESETS[preset]
            given.setdefault("through_gym", below.through_gym)
            for name, settings in (("hyperparameters", below.ppo), ("curiosity", below.curiosity)):
                given[name] = _over(name, type(settings), settings, given.get(name, {}))
        kind = next((kind for name, kind in OTHERS.items() if name == algorithm), None)
        own = given.pop("own_hyperparameters", None)
        if kind is not None:
            given["own_hyperparameters"] = _over("own_hyperparameters", kind, kind(), own or {})
        elif own is not None:
            raise SettingError(
                f"own_hyperparameters are of algorithms other than {shown(algorithm)}; take them out.",
                "own_hyperparameters",
            )
        return super().from_mapping(given)

    @property
    def base(self) -> Preset:
        """It in the form of a preset; how many areas there are is said elsewhere."""
        return replace(
            PRESETS[self.preset], through_gym=self.through_gym, ppo=self.hyperparameters, curiosity=self.curiosity
        )

    @classmethod
    def of(cls, config: RunConfig) -> Self:
        """Those of a run in lockstep."""
        return cls(
            preset=config.preset,
            algorithm=config.algo,
            through_gym=config.through_gym,
            hyperparameters=config.ppo,
            own_hyperparameters=config.other,
            curiosity=config.curiosity,
            penalty=config.penalty,
            from_sb3=config.from_sb3,
            max_steps=config.steps,
        )


def _over(name: str, kind: type[Settings], below: Settings, values: object) -> Settings:
    try:
        return kind.from_mapping(merged(below.as_dict(), names_and_values(values, name)))
    except SettingError as error:
        raise error.within(name) from error


@dataclass(frozen=True)
class PaperBehavior:
    """What a file has of it.

    Attributes:
        settings: How it is trained.
        behavior: Which, without its team; None is whichever the environment has.
    """

    settings: PaperSettings = field(default_factory=PaperSettings)
    behavior: str | None = None


def read_paper_behavior(behaviors: object, default_settings: object) -> PaperBehavior | None:
    """The behavior of ``trainer_type: paper`` in a file's sections; None if there is none.

    Args:
        behaviors: The section of that name.
        default_settings: The section of that name; None if there is none.

    Raises:
        SettingError: Something in it can't be used, or it is not the only one.
    """
    listed = names_and_values(behaviors, "behaviors")
    if _is_paper(default_settings) and not listed:
        try:
            return PaperBehavior(PaperSettings.from_mapping(default_settings))
        except SettingError as error:
            raise error.within("default_settings") from error
    for name, values in listed.items():
        if not _is_paper(values):
            continue
        if len(listed) > 1 or default_settings is not None:
            raise SettingError(
                f"{shown(name)} has trainer_type paper, which trains the only behavior of an environment; take the "
                "others and default_settings out.",
                "behaviors",
                name,
            )
        try:
            return PaperBehavior(PaperSettings.from_mapping(values), str(name))
        except SettingError as error:
            raise error.within("behaviors", name) from error
    return None


def _is_paper(values: object) -> bool:
    return isinstance(values, Mapping) and values.get("trainer_type") == PAPER


def paper_sections(config: RunConfig, behavior: str) -> dict[str, Any]:
    """A run in lockstep in the form of ``mlagents-learn``'s YAML, which ``corridor train`` takes as its file.

    Args:
        config: The run.
        behavior: Its behavior, with or without the team.
    """
    parameters = config.environment_parameters
    if not is_corridor(behavior):  # only a corridor was sent the preset's
        parameters = {name: value for name, value in parameters.items() if name not in config.preset_parameters}
    return {
        "behaviors": {behavior.partition("?")[0]: PaperSettings.of(config).as_dict()},
        **config.surroundings(parameters),
    }


def preset_file(preset: PresetName) -> str:
    """A preset as a file, every setting in it, for a user to change."""
    import yaml

    run = preset_run("preset", preset, c=CURIOSITY_RATIO, seed=0, steps=PAPER_STEPS)
    text = yaml.safe_dump(paper_sections(run, BEHAVIOR), sort_keys=False)
    return f"# corridor train --run-id ID --preset {preset}, said by a file. make docs writes it from the code.\n{text}"

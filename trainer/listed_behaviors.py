"""The sections ``behaviors`` and ``default_settings`` of ``mlagents-learn``'s YAML: which behavior is trained how.

A behavior's settings stand over the default ones, name by name, as in mlagents 1.1.0.
"""

from collections.abc import Collection, Mapping
from typing import Any

from corridor_server.shared.given import shown
from trainer.behavior_settings import BehaviorSettings
from trainer.errors import SettingError
from trainer.options import names_and_values, nearest


def read_behaviors(
    behaviors: object, default_settings: object
) -> tuple[dict[str, BehaviorSettings], BehaviorSettings | None]:
    """The settings of every behavior, each over the default ones, and those.

    Args:
        behaviors: The section of that name.
        default_settings: The section of that name; None if there is none.

    Raises:
        SettingError: Something in it can't be used.
    """
    try:
        default = None if default_settings is None else BehaviorSettings.from_mapping(default_settings)
    except SettingError as error:
        raise error.within("default_settings") from error
    read = {}
    for name, values in names_and_values(behaviors, "behaviors").items():
        try:
            if not isinstance(name, str) or not name or "?" in name:
                raise SettingError(f"{shown(name)} is no behavior's name; give it as a text, and without its team.")
            read[name] = BehaviorSettings.from_mapping(_over(default, names_and_values(values, name)))
        except SettingError as error:
            raise error.within("behaviors", name) from error
    return read, default


def _over(default: BehaviorSettings | None, values: Mapping[Any, Any]) -> Mapping[Any, Any]:
    if default is None:
        return values
    trainer_type = values.get("trainer_type", default.trainer_type)
    if trainer_type != default.trainer_type:
        raise SettingError(
            f"trainer_type is {shown(trainer_type)}, but default_settings has {default.trainer_type}, whose "
            "hyperparameters another trainer can't have; take default_settings out, or give both the same.",
            "trainer_type",
        )
    return merged(default.as_dict(), values)


def merged(below: Mapping[Any, Any], above: Mapping[Any, Any]) -> dict[Any, Any]:
    """Names and values, those of the second over those of the first, also within sections."""
    both = dict(below)
    for name, value in above.items():
        are_sections = isinstance(both.get(name), Mapping) and isinstance(value, Mapping)
        both[name] = merged(both[name], value) if are_sections else value
    return both


def settings_for(
    behavior: str, behaviors: Mapping[str, BehaviorSettings], default: BehaviorSettings | None
) -> BehaviorSettings:
    """A behavior's settings: its own, else the default ones, else ML-Agents'.

    Args:
        behavior: Its name, with or without a team.
        behaviors: Those that are listed.
        default: The default ones, if there are any.

    Raises:
        SettingError: Behaviors are listed, but not this one, and there are no default settings.
    """
    name = behavior.partition("?")[0]
    if name in behaviors:
        return behaviors[name]
    if behaviors and default is None:
        raise SettingError(
            f"The environment has the behavior {shown(name)}, which is not among the behaviors of the configuration "
            f"({nearest(name, behaviors)}); list it there, or add default_settings.",
            "behaviors",
        )
    return default or BehaviorSettings()


def check_behaviors(
    found: Collection[str], behaviors: Mapping[str, BehaviorSettings], default: BehaviorSettings | None
) -> list[str]:
    """Refuses an environment whose behaviors are not those that settings are for.

    Args:
        found: Its behaviors.
        behaviors: Those that are listed.
        default: The default settings, if there are any.

    Returns:
        Those that are listed and not there, while all that are there are listed: they may come later.

    Raises:
        SettingError: One is not listed, and there are no default settings; or one that is listed is not there, and one
            that is there, which may be the one that was meant, is not listed.
    """
    for name in found:
        settings_for(name, behaviors, default)
    missing = [name for name in behaviors if name not in found]
    if missing and not set(found) <= set(behaviors):
        raise SettingError(
            f"behaviors has {shown(missing[0])}, which the environment doesn't have ({nearest(missing[0], found)}); "
            "rename it, or take it out.",
            "behaviors",
            missing[0],
        )
    return missing

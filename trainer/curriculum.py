"""Environment parameters that change as a run learns: lessons, when each is over, and which one it is.

What counts when is as mlagents 1.1.0 has it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

from corridor_server.shared.given import Range, shown
from trainer.errors import SettingError, TrainerError
from trainer.options import Settings, names_and_values, nearest
from trainer.parameter_values import parse_parameter

NEW = 0.75  # of a smoothed reward, what is of the last episodes


@dataclass(frozen=True)
class CompletionCriteria(Settings):
    """When a lesson is over.

    Attributes:
        behavior: Whose progress or reward counts.
        measure: Its share of ``max_steps``, or the mean reward of its last episodes.
        min_lesson_length: Episodes that a lesson has at least.
        signal_smoothing: Whether a quarter of a reward is that of the time before.
        threshold: What is to be exceeded.
        require_reset: Whether every episode begins anew with the next lesson.
    """

    SECTION: ClassVar = "completion_criteria"
    behavior: str
    measure: Literal["reward", "progress"] = "reward"
    min_lesson_length: Annotated[int, Range(0, 10**6)] = 0
    signal_smoothing: bool = True
    threshold: float = 0.0
    require_reset: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.measure == "progress" and not 0.0 <= self.threshold <= 1.0:
            raise SettingError(
                f"The setting threshold is {self.threshold:g}, but with measure progress it is a share of max_steps, "
                "and a number from 0 to 1 was expected.",
                "threshold",
            )


@dataclass(frozen=True)
class Lesson(Settings):
    """One value of an environment parameter.

    Attributes:
        name: The lesson's.
        value: A number, or a sampler's type and parameters, as the YAML file has it.
        completion_criteria: When it is over; None in the last lesson, where ML-Agents doesn't look at it.
    """

    SECTION: ClassVar = "a lesson"
    name: str
    value: Any
    completion_criteria: CompletionCriteria | None = None

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings; criteria that are null are not there.

        Raises:
            SettingError: Something in it can't be used.
        """
        given = dict(names_and_values(values, cls.SECTION))
        if given.get("completion_criteria", ...) is None:
            del given["completion_criteria"]
        return super().from_mapping(given)


def read_lessons(name: str, value: Any) -> tuple[Lesson, ...]:
    """An environment parameter's lessons; what has no curriculum has one that never ends.

    Args:
        name: The parameter's.
        value: A number, a sampler's type and parameters, or ``{"curriculum": [...]}``.

    Raises:
        SettingError: It has none of these forms.
    """
    if not isinstance(value, Mapping) or "curriculum" not in value:
        parse_parameter(name, value, 0)
        return (Lesson(str(name), value),)
    listed = value["curriculum"]
    for other in value:
        if other != "curriculum":
            raise SettingError(f"{name} has a curriculum and {shown(other)}; values belong in its lessons.", other)
    if not isinstance(listed, list | tuple) or not listed:
        raise SettingError(
            f"The curriculum of {name} is {shown(listed)}, but a list of lessons was expected.", "curriculum"
        )
    return tuple(_read_lesson(name, index, each, len(listed)) for index, each in enumerate(listed))


def _read_lesson(parameter: str, index: int, values: Any, count: int) -> Lesson:
    try:
        lesson = Lesson.from_mapping(values)
        if lesson.completion_criteria is None and index < count - 1:
            raise SettingError(
                f"The lesson {shown(lesson.name)} of {parameter} has no completion_criteria, so those after it would "
                "never come; give it criteria, or take those out."
            )
        try:
            parse_parameter(parameter, lesson.value, 0)
        except SettingError as error:
            raise error.within("value") from error
    except SettingError as error:
        raise error.within("curriculum", index) from error
    return lesson


class Curricula:
    """Which lesson each environment parameter is in.

    Args:
        parameters: Names and numbers, samplers or curricula, in the form of ``mlagents-learn``'s YAML.

    Raises:
        SettingError: One of them has another form.
    """

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self._lessons: dict[str, tuple[Lesson, ...]] = {}
        for name, value in names_and_values(parameters, "environment_parameters").items():
            try:
                self._lessons[name] = read_lessons(name, value)
            except SettingError as error:
                raise error.within(name) from error
        self._numbers = dict.fromkeys(self._lessons, 0)
        self._smoothed = dict.fromkeys(self._lessons, 0.0)

    @property
    def are_taught(self) -> bool:
        """Whether any parameter has lessons to go on to."""
        return any(len(lessons) > 1 for lessons in self._lessons.values())

    @property
    def numbers(self) -> dict[str, int]:
        """The number of each parameter's lesson, from 0."""
        return dict(self._numbers)

    def values(self) -> dict[str, Any]:
        """Each parameter's number or sampler in its lesson, as ``parse_parameter`` reads it."""
        return {name: lessons[self._numbers[name]].value for name, lessons in self._lessons.items()}

    def episodes(self, behavior: str) -> int:
        """How many of a behavior's last episodes ``update`` is to be given: the longest ``min_lesson_length``."""
        return max([1, *(each.min_lesson_length for each in self._criteria() if each.behavior == behavior)])

    def check_behaviors(self, found: Iterable[str]) -> None:
        """Refuses lessons that would never end, because they wait for a behavior that is not there.

        Args:
            found: The environment's behaviors, without their teams.

        Raises:
            TrainerError: There is one.
        """
        known = list(found)
        for criteria in self._criteria():
            if criteria.behavior not in known:
                raise TrainerError(
                    f"A lesson's completion_criteria wait for the behavior {shown(criteria.behavior)}, which the "
                    f"environment doesn't have; {nearest(criteria.behavior, known)}."
                )

    def update(self, behavior: str, progress: float, rewards: Sequence[float]) -> tuple[bool, bool]:
        """Goes to the next lesson wherever the present one is over.

        Args:
            behavior: Whose progress and rewards these are, without its team.
            progress: Its steps, divided by its ``max_steps``.
            rewards: Of its last episodes, at most ``episodes(behavior)`` of them, and none that ended before the last
                change of any lesson.

        Returns:
            Whether a lesson has changed, and whether all episodes have to begin anew with it.
        """
        changed = must_reset = False
        for name, lessons in self._lessons.items():
            criteria = lessons[self._numbers[name]].completion_criteria
            last = self._numbers[name] == len(lessons) - 1
            if last or criteria is None or criteria.behavior != behavior:
                continue
            if self._is_over(name, criteria, progress, rewards):
                self._numbers[name] += 1
                changed = True
                must_reset |= criteria.require_reset
        return changed, must_reset

    def state_dict(self) -> dict[str, Any]:
        """The lessons and what their smoothing remembers, as plain values for ``load_state_dict``."""
        return {"lessons": dict(self._numbers), "smoothed": dict(self._smoothed)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on from what ``state_dict`` gave.

        Raises:
            TrainerError: It is that of other parameters or lessons.
        """
        try:
            numbers = {
                name: Range(0, len(each) - 1).read(state["lessons"][name], True) for name, each in self._lessons.items()
            }
            smoothed = {name: Range().read(state["smoothed"][name]) for name in self._lessons}
        except (KeyError, TypeError) as error:
            raise TrainerError(f"The checkpoint's lessons are of other environment parameters ({error}).") from error
        for name in self._lessons:
            number, value = numbers[name], smoothed[name]
            if number is None or value is None:
                raise TrainerError(
                    f"The checkpoint is in lesson {shown(state['lessons'][name])} of {name}, but there are "
                    f"{len(self._lessons[name])}, counted from 0; train the run again with --force."
                )
            self._numbers[name], self._smoothed[name] = int(number), value

    def _criteria(self) -> list[CompletionCriteria]:
        every = (lesson.completion_criteria for lessons in self._lessons.values() for lesson in lessons[:-1])
        return [each for each in every if each is not None]

    def _is_over(self, name: str, criteria: CompletionCriteria, progress: float, rewards: Sequence[float]) -> bool:
        if len(rewards) < criteria.min_lesson_length:
            return False
        if criteria.measure == "progress":
            return progress > criteria.threshold
        if not rewards:
            return False
        reward = math.fsum(rewards) / len(rewards)
        if reward != reward:  # an episode's reward was no number
            return False
        if criteria.signal_smoothing:
            reward = self._smoothed[name] = (1.0 - NEW) * self._smoothed[name] + NEW * reward
        return reward > criteria.threshold

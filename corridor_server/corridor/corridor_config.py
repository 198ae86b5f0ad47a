"""The corridor's numbers: one frozen dataclass from which validation, side-channel names and docs derive."""

import difflib
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any

from corridor_server.corridor import observation as layout
from corridor_server.shared import given

Range = tuple[float, float]


def _parameter(default: float | Range, unit: str, text: str, low: float, high: float) -> Any:
    return field(default=default, metadata={"unit": unit, "text": text, "range": (low, high)})


@dataclass(frozen=True)
class CorridorConfig:
    """Geometry, motion and reward of the corridor; every default is the paper's value or the calibrated one.

    The corridor is ``2 * half_length`` long (x) and ``2 * half_width`` wide (z), with its centre at the origin.
    A range such as ``agent_spawn_x`` is drawn from uniformly at each episode's start.

    Raises:
        ValueError: A value is of the wrong type or out of its range; the message names field, value and range.
    """

    half_length: float = _parameter(10.0, "m", "half the corridor's length, along x", 1.0, 1000.0)
    half_width: float = _parameter(5.0, "m", "half the corridor's width, along z", 1.0, 1000.0)
    agent_radius: float = _parameter(0.5, "m", "radius of the learning agent", 0.01, 10.0)
    opponent_radius: float = _parameter(0.5, "m", "radius of each opponent", 0.01, 10.0)
    fixed_timestep: float = _parameter(0.02, "s", "one physics step, as Unity's FixedUpdate", 0.001, 1.0)
    decision_period: int = _parameter(5, "steps", "physics steps between two decisions", 1, 100)
    agent_speed: float = _parameter(2.0, "m/s", "the agent's speed along an axis at action 1", 0.0, 100.0)
    agent_time_constant: float = _parameter(
        0.5, "s", "lag of velocity behind action; 0 means that velocity follows at once", 0.0, 100.0
    )
    opponent_speed: float = _parameter(1.0, "m/s", "the opponents' speed, straight to their targets", 0.0, 100.0)
    agent_spawn_x: Range = _parameter((-4.0, -2.0), "m", "where the agent starts", -1000.0, 1000.0)
    opponent_spawn_x: Range = _parameter((7.0, 8.5), "m", "where the opponents start", -1000.0, 1000.0)
    spawn_z: float = _parameter(3.0, "m", "agent and opponents start within +- this", 0.0, 1000.0)
    goal_x: float = _parameter(9.0, "m", "the agent's target", -1000.0, 1000.0)
    goal_z: float = _parameter(3.0, "m", "the agent's target lies within +- this", 0.0, 1000.0)
    goal_radius: float = _parameter(0.75, "m", "reached when the agent's centre is this near", 0.0, 1000.0)
    opponent_target_x: float = _parameter(-9.0, "m", "the opponents' targets", -1000.0, 1000.0)
    opponent_target_z: float = _parameter(2.5, "m", "the opponents' targets lie within +- this", 0.0, 1000.0)
    switch_x: float = _parameter(0.0, "m", "the switch", -1000.0, 1000.0)
    switch_z: float = _parameter(3.0, "m", "the switch", -1000.0, 1000.0)
    switch_radius: float = _parameter(1.5, "m", "the switch turns on when the agent's centre is this near", 0.0, 1000.0)
    near_distance: float = _parameter(
        0.2, "half-lengths", "eq. 9's near zone around an opponent, centre to centre", 0.0, 10.0
    )
    goal_reward: float = _parameter(1.0, "", "eq. 9: d_goal = 0, with the switch on", -1000.0, 1000.0)
    wall_penalty: float = _parameter(0.1, "", "eq. 9: d_wall = 0 (subtracted)", 0.0, 1000.0)
    contact_penalty: float = _parameter(0.25, "", "eq. 9: d_opp = 0 (subtracted)", 0.0, 1000.0)
    near_penalty: float = _parameter(0.1, "", "eq. 9: the constant part in the near zone (subtracted)", 0.0, 1000.0)
    step_penalty: float = _parameter(0.001, "", "eq. 9: every other step (subtracted)", 0.0, 1000.0)
    failure_return: float = _parameter(-1.0, "", "the episode fails at this accumulated reward", -1e6, 0.0)
    failure_penalty: float = _parameter(1.0, "", "subtracted when it fails; 0 in case study B", 0.0, 1000.0)
    max_episode_steps: int = _parameter(0, "decisions", "step limit that truncates an episode; 0 means none", 0, 10**9)
    num_opponents: int = _parameter(1, "", "K of eq. 8; the reward takes the nearest", 1, 64)

    def __post_init__(self) -> None:
        for parameter in fields(self):
            object.__setattr__(self, parameter.name, _checked(parameter, getattr(self, parameter.name)))
        for name, radius in (("agent_radius", self.agent_radius), ("opponent_radius", self.opponent_radius)):
            if radius >= min(self.half_length, self.half_width):
                raise ValueError(
                    f"{name} is {radius:g}, but the corridor is only {2 * self.half_length:g} x "
                    f"{2 * self.half_width:g} m; make it smaller or the corridor larger."
                )

    @property
    def observation_size(self) -> int:
        """Number of floats in an observation: 8 + 5K (eq. 10)."""
        return layout.size(self.num_opponents)

    @property
    def decision_seconds(self) -> float:
        """Time between two decisions, in seconds."""
        return self.fixed_timestep * self.decision_period

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> "CorridorConfig":
        """Builds a config from names and values, as read from a file.

        Raises:
            ValueError: A name is unknown (the nearest known one is named) or a value is not accepted.
        """
        known = [parameter.name for parameter in fields(cls)]
        for name in values:
            if name not in known:
                near = difflib.get_close_matches(given.shown(name), known, n=1, cutoff=0.4)
                hint = f"did you mean '{near[0]}'?" if near else f"known ones are {', '.join(known)}."
                raise ValueError(f"{given.shown(name)} is not a parameter of the corridor; {hint}")
        return cls(**values)

    @classmethod
    def from_file(cls, path: Path) -> "CorridorConfig":
        """Reads a config from a YAML or JSON file of names and values.

        Raises:
            ValueError: The file can't be read or parsed, or its contents are not accepted.
        """
        values = given.read_mapping(path)
        try:
            return cls.from_mapping(values)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def _checked(parameter: "Field[Any]", value: Any) -> float | int | Range:
    """Returns the value in its field's type, or raises a ValueError that says what was expected."""
    low, high = parameter.metadata["range"]
    allowed, whole = given.Range(low, high), parameter.type is int
    if parameter.type is not Range:
        number = allowed.read(value, whole)
        if number is not None:
            return number
        expected = allowed.described(whole)
    else:
        expected = f"two numbers [low, high] from {low:g} to {high:g}"
        pair = value.tolist() if hasattr(value, "tolist") else value  # NumPy's
        ends = [allowed.read(end) for end in pair] if isinstance(pair, list | tuple) else []
        if len(ends) == 2 and ends[0] is not None and ends[1] is not None and ends[0] <= ends[1]:
            return ends[0], ends[1]
    unit = f" {parameter.metadata['unit']}" if parameter.metadata["unit"] else ""
    raise ValueError(f"{parameter.name} is {given.shown(value)}, but {expected}{unit} was expected.")


def settable_parameters() -> dict[str, Range]:
    """Names that can change from one episode to the next, with the range that each accepts.

    These are the names of the environment-parameters side channel. A range field of ``CorridorConfig`` has three:
    ``NAME_min``, ``NAME_max``, and ``NAME`` itself, which sets both ends. ``num_opponents`` is not among them, since
    it is the observation's size, which a connection can't change.
    """
    names: dict[str, Range] = {}
    for parameter in fields(CorridorConfig):
        limits = parameter.metadata["range"]
        if parameter.name == "num_opponents":
            continue
        names[parameter.name] = limits
        if parameter.type is Range:
            names[f"{parameter.name}_min"] = limits
            names[f"{parameter.name}_max"] = limits
    return names


def parameter_table() -> str:
    """The corridor's parameters as a Markdown table (``docs/parameters.md``)."""
    rows = ["| name | default | unit | range | what it is |", "|---|---|---|---|---|"]
    for parameter in fields(CorridorConfig):
        default = getattr(CorridorConfig(), parameter.name)
        default = list(default) if isinstance(default, tuple) else default
        low, high = parameter.metadata["range"]
        unit = parameter.metadata["unit"] or "-"
        rows.append(f"| `{parameter.name}` | {default} | {unit} | {low:g} to {high:g} | {parameter.metadata['text']} |")
    return "\n".join(rows)

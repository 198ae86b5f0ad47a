"""What a scene is made of: one TOML file for each case."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

SPECS = Path(__file__).parents[1] / "specs"


@dataclass(frozen=True)
class Sensor:
    """``vector`` and ``goal`` have a ``size``, ``buffer`` ``rows`` of that size, ``picture`` a ``shape`` (C, H, W)."""

    kind: str = "vector"
    name: str = ""
    size: int = 1
    rows: int = 0
    shape: tuple[int, ...] = ()
    png: bool = True


@dataclass(frozen=True)
class AgentSpec:
    """One agent of an area; times are in fixed steps, and 0 means never.

    It asks for a decision every ``period`` steps, at ``offset``, and repeats its action ``between``, unless told not
    to. An episode is terminated at the target, or after ``episode`` steps; it is interrupted after ``max_step``. The
    object is created at ``born``, disabled after ``lives`` steps, and enabled again, with a new id, after ``away``.
    """

    period: int = 1
    offset: int = 0
    between: bool = True
    episode: int = 0
    max_step: int = 0
    group: str = ""
    born: int = 0
    lives: int = 0
    away: int = 0


@dataclass(frozen=True)
class BehaviorSpec:
    """``statistics`` are sent at every end (``always``), at none (``never``), or only at one kind (``terminated``)."""

    name: str
    team: int = 0
    world: str = "line"
    continuous: int = 0
    discrete: tuple[int, ...] = ()
    masks: bool = False
    statistics: str = "never"
    sensors: tuple[Sensor, ...] = (Sensor(size=3),)
    agents: tuple[AgentSpec, ...] = (AgentSpec(),)

    @property
    def full_name(self) -> str:
        return f"{self.name}?team={self.team}"


@dataclass(frozen=True)
class Spec:
    """A scene. ``replicator``: it makes num_areas copies of the area. ``groups``: name -> max_step.

    After ``announces_end`` messages the build ends by itself: it says so with status 400, and its process lives on for
    ``lingers`` seconds.
    """

    behaviors: tuple[BehaviorSpec, ...]
    replicator: bool = False
    groups: dict[str, int] = field(default_factory=dict)
    announces_end: int = 0
    lingers: float = 0.0


def load(given: str) -> Spec:
    """A spec by its path, or by the name of one of those in ``specs``."""
    path = Path(given) if given.endswith(".toml") else SPECS / f"{given}.toml"
    read = tomllib.loads(path.read_text())
    behaviors = []
    for table in read.pop("behaviors"):
        for key, kind in (("sensors", Sensor), ("agents", AgentSpec)):
            if key in table:
                table[key] = tuple(kind(**each) for each in table[key])
        behaviors.append(BehaviorSpec(**{**table, "discrete": tuple(table.get("discrete", ()))}))
    return Spec(behaviors=tuple(behaviors), **read)

"""Which runs a study consists of."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from trainer.config import PresetName, RunConfig
from trainer.corridor import LEARNER_COLOUR
from trainer.hyperparameters import Algorithm, Intrinsic, PPOConfig
from trainer.presets import preset_run


@dataclass(frozen=True)
class Arm:
    """Settings that a study's runs share but for the seed; a line of its figures.

    Attributes:
        name: Part of its runs' ids.
        label: What figures and tables call it.
        c: The paper's curiosity ratio.
        penalty: What a failed episode costs on top.
        gamma: Discount factor; the preset's if None.
        algo: The learning algorithm.
        intrinsic: What curiosity is paid for.
    """

    name: str
    label: str
    c: float
    penalty: float = 1.0
    gamma: float | None = None
    algo: Algorithm = "ppo"
    intrinsic: Intrinsic = "icm"

    def run_id(self, seed: int) -> str:
        """What one of its runs is called."""
        return f"{self.name}-seed{seed}"

    def run(self, preset: PresetName, steps: int, seed: int) -> RunConfig:
        """One of its runs on the corridor."""
        config = preset_run(
            self.run_id(seed),
            preset,
            c=self.c,
            seed=seed,
            steps=steps,
            penalty=self.penalty,
            algo=self.algo,
            intrinsic=self.intrinsic,
        )
        if self.gamma is not None:
            config = dataclasses.replace(config, ppo=dataclasses.replace(config.ppo, gamma=self.gamma))
        return config


@dataclass(frozen=True)
class World:
    """What a study's runs are trained on.

    Attributes:
        name: What reports call it.
        run: An arm's run with a seed.
        preset: What the runs began as, on the corridor; None elsewhere.
    """

    name: str
    run: Callable[[Arm, int], RunConfig]
    preset: PresetName | None = None


def corridor_world(preset: PresetName, steps: int) -> World:
    """The paper's corridor, as a preset trains on it for so many agent steps."""
    return World(f"preset {preset}", lambda arm, seed: arm.run(preset, steps, seed), preset)


@dataclass(frozen=True)
class CurveFigure:
    """A pair of learning-curve figures: reward above, episode length below, as the paper's Figs 5 and 6.

    Attributes:
        name: ``figure5`` gives ``figure5a.png`` and ``figure5b.png``.
        title: What it compares.
        colours: Arm names and colours for them (the paper's, if it has any), in the legend's order.
    """

    name: str
    title: str
    colours: dict[str, str]


@dataclass(frozen=True)
class DoseFigure:
    """Success and episode length against a setting.

    Attributes:
        name: Of its PNG file.
        title: What it shows.
        setting: The horizontal axis.
        lines: For each line's label, the setting's values with the arms that have them.
    """

    name: str
    title: str
    setting: str
    lines: dict[str, tuple[tuple[float, Arm], ...]]


@dataclass(frozen=True)
class Study:
    """What is compared, and what for.

    Attributes:
        name: Of its folder and command.
        title: Of its report.
        arms: What is compared.
        figures: Learning curves to draw.
        claims: Ids of the claims that it decides.
        doses: Dose-response curves to draw.
        gamma: The discount factor that runs have to begin with, because others stand beside it; None is any.
    """

    name: str
    title: str
    arms: tuple[Arm, ...]
    figures: tuple[CurveFigure, ...] = ()
    claims: tuple[str, ...] = ()
    doses: tuple[DoseFigure, ...] = ()
    gamma: float | None = None

    def elsewhere(self, world: World) -> "Study":
        """The same on an environment of others, of which the paper claims nothing."""
        return dataclasses.replace(self, title=f"{self.title.partition(' (')[0]}: {world.name}", claims=())

    def runs(self, world: World, seeds: Sequence[int]) -> dict[str, list[RunConfig]]:
        """The study's runs by arm name, one per seed."""
        return {arm.name: [world.run(arm, seed) for seed in seeds] for arm in self.arms}


BASE = Arm("c0", "base PPO (c = 0)", 0.0)
C01 = Arm("c0.1", "c = 0.1", 0.1)
C03 = Arm("c0.3", "c = 0.3", 0.3)
C05 = Arm("c0.5", "c = 0.5", 0.5)
NO_PENALTY = Arm("c0.3-no-penalty", "c = 0.3, no penalty", 0.3, penalty=0.0)
BASE_NO_PENALTY = Arm("c0-no-penalty", "base PPO, no penalty", 0.0, penalty=0.0)

# The paper's colours.
BLUE, RED, GREEN, PURPLE = "#1f5fbf", "#d1352b", "#2f9e44", "#8443a8"

FIGURE_5 = CurveFigure(
    "figure5", "Curiosity ratio", {C03.name: BLUE, C01.name: RED, C05.name: GREEN, BASE.name: PURPLE}
)
FIGURE_6 = CurveFigure("figure6", "Added penalty", {C03.name: BLUE, NO_PENALTY.name: RED, BASE_NO_PENALTY.name: GREEN})

_RATIO_ARMS = (BASE, C01, C03, C05)
_PENALTY_ARMS = (C03, NO_PENALTY, BASE_NO_PENALTY)
_RATIO_CLAIMS, _PENALTY_CLAIMS = ("C1", "C2", "C3", "C4"), ("C5", "C6", "C7")

CURIOSITY_RATIO = Study(
    "curiosity-ratio",
    "Influence of the curiosity ratio (section IV-A, Fig. 5)",
    _RATIO_ARMS,
    (FIGURE_5,),
    _RATIO_CLAIMS,
)
PENALTY = Study(
    "penalty", "Influence of the added penalty (section IV-B, Fig. 6)", _PENALTY_ARMS, (FIGURE_6,), _PENALTY_CLAIMS
)
CASE_STUDIES = Study(
    "case-studies",
    "Both case studies of the paper (section IV, Figs 5 and 6)",
    (*_RATIO_ARMS, *_PENALTY_ARMS[1:]),
    (FIGURE_5, FIGURE_6),
    _RATIO_CLAIMS + _PENALTY_CLAIMS,
)

_COLOURS = {"ppo": BLUE, "a2c": RED, "trpo": GREEN, "ddpg": PURPLE}
_OTHERS: tuple[Algorithm, ...] = ("a2c", "trpo", "ddpg")
_CURIOUS = tuple(Arm(f"{algo}-c0.3", f"{algo.upper()}, c = 0.3", 0.3, algo=algo) for algo in _OTHERS)
_INCURIOUS = tuple(Arm(f"{algo}-c0", f"{algo.upper()}, c = 0", 0.0, algo=algo) for algo in _OTHERS)
RND = Arm("rnd-c0.3", "PPO with RND, c = 0.3", 0.3, intrinsic="rnd")

ALGORITHMS = Study(
    "algorithms",
    "Other algorithms (section III-A), and another intrinsic reward (section II-B)",
    (C03, RND, *_CURIOUS, BASE, *_INCURIOUS),
    (
        CurveFigure(
            "curious-",
            "With curiosity",
            {C03.name: BLUE, RND.name: LEARNER_COLOUR, **{arm.name: _COLOURS[arm.algo] for arm in _CURIOUS}},
        ),
        CurveFigure(
            "incurious-",
            "Without curiosity",
            {BASE.name: BLUE, **{arm.name: _COLOURS[arm.algo] for arm in _INCURIOUS}},
        ),
    ),
)

_BY_C = (BASE, C01, C03, C05, *(Arm(f"c{c:g}", f"c = {c:g}", c) for c in (0.75, 1.0, 1.5, 2.0)))


def _with_gamma(base: Arm, gamma: float) -> Arm:
    if gamma == PPOConfig().gamma:
        return base
    c, dash, rest = base.name.partition("-")
    return dataclasses.replace(
        base, name=f"{c}-gamma{gamma:g}{dash}{rest}", label=f"{base.label}, gamma = {gamma:g}", gamma=gamma
    )


_BY_GAMMA = {
    line: tuple((gamma, _with_gamma(base, gamma)) for gamma in (0.95, 0.96, 0.97, 0.99))
    for line, base in (
        ("c = 0.3, with penalty", C03),
        ("c = 0.3, without penalty", NO_PENALTY),
        ("base PPO, with penalty", BASE),
        ("base PPO, without penalty", BASE_NO_PENALTY),
    )
}

DOSE_RESPONSE = Study(
    "dose-response",
    "What the claims depend on: the curiosity ratio from 0 to 2, and gamma with and without the penalty",
    tuple(dict.fromkeys((*_BY_C, *(arm for line in _BY_GAMMA.values() for _, arm in line)))),
    doses=(
        DoseFigure("dose-c", "Curiosity ratio", "c", {"with penalty": tuple((arm.c, arm) for arm in _BY_C)}),
        DoseFigure("dose-gamma", "Discount factor and penalty", "gamma", _BY_GAMMA),
    ),
    gamma=PPOConfig().gamma,
)

STUDIES = (CURIOSITY_RATIO, PENALTY, CASE_STUDIES, ALGORITHMS, DOSE_RESPONSE)

"""The paper's claims, each with the measure that decides it: fixed before the runs, and decided by nothing else.

Aggregates over seeds are interquartile means (IQM); intervals are 95% stratified bootstrap intervals (``bootstrap``).

A claim is decided only where its measures can be: from ``FEWEST_SEEDS`` finished runs of each arm on, each of as many
steps as the paper's and evaluated on ``FEWEST_EPISODES``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trainer.config import PAPER_STEPS
from trainer.studies.bootstrap import Estimate, difference, interval, iqm
from trainer.studies.plan import BASE, BASE_NO_PENALTY, C01, C03, C05, NO_PENALTY, Arm
from trainer.studies.results import RunResult, scores, steps_to

FAILS_BELOW = 0.05  # success of an agent that does not complete the task
COMPLETES_FROM = 0.90  # success of one that does
OVERWHELMED_BELOW = 0.5  # success of one that curiosity overwhelms
QUICKLY_BELOW = 0.5  # its episode length, as a share of base PPO's
# Of three values a mean leaves out none, so it is no interquartile one; and by chance alone all runs of one arm lie
# below all of the other 1 time in 20 with three each, 1 in 70 with four.
FEWEST_SEEDS = 4
FEWEST_EPISODES = 60  # none of which succeeds in 5% of the cases, where success is FAILS_BELOW
ENOUGH_SEEDS = 10
MINIMUM = (
    f"at least {FEWEST_SEEDS} seeds of each arm, {PAPER_STEPS:,} agent steps per run and {FEWEST_EPISODES} episodes in "
    "its evaluation"
)
BOOTSTRAP_SEED = 0

Results = Mapping[str, Sequence[RunResult]]  # by arm name
Verdict = tuple[bool, str]


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper.

    Attributes:
        id: C1 to C7.
        statement: What the paper says.
        measure: When it holds.
        arms: The arms whose runs decide it.
        decide: The measure: whether it holds, and the numbers that say so.
    """

    id: str
    statement: str
    measure: str
    arms: tuple[Arm, ...]
    decide: Callable[[Results, np.random.Generator], Verdict]

    def judge(self, results: Results) -> dict[str, Any]:
        """The claim as ``claims.json`` has it; ``holds`` is None where there is too little to decide it by."""
        lacking = _lacking(results, self.arms)
        holds: bool | None = None
        if any(not results.get(arm.name) for arm in self.arms):
            evidence = lacking
        else:
            decided, evidence = self.decide(results, np.random.default_rng(BOOTSTRAP_SEED))
            if lacking:
                evidence = f"{lacking} So far: {evidence}"
            else:
                holds = decided
                evidence += _reservation(results, self.arms)
        return {
            "id": self.id,
            "statement": self.statement,
            "measure": self.measure,
            "holds": holds,
            "evidence": evidence,
        }


def _lacking(results: Results, arms: Sequence[Arm]) -> str:
    """Says what there is less of than a claim is decided by; empty if there is enough of everything."""
    missing = [arm.label for arm in arms if not results.get(arm.name)]
    if missing:
        return f"Not decided: no finished run of {', '.join(missing)}."
    runs = [run for arm in arms for run in results[arm.name]]
    seeds = min(len(results[arm.name]) for arm in arms)
    steps = min(run.config.steps for run in runs)
    episodes = min(int(run.measure("episodes") or 0) for run in runs)
    short = [
        f"{there:,} of {needed:,} {what}"
        for what, there, needed in (
            ("seeds", seeds, FEWEST_SEEDS),
            ("steps per run", steps, PAPER_STEPS),
            ("episodes in an evaluation", episodes, FEWEST_EPISODES),
        )
        if there < needed
    ]
    return f"Not decided: there are {', '.join(short)}." if short else ""


def _reservation(results: Results, arms: Sequence[Arm]) -> str:
    """Says where a claim is decided by fewer seeds than are meant."""
    fewest = min(len(results[arm.name]) for arm in arms)
    return f" Only {fewest} seeds; {ENOUGH_SEEDS} are meant." if fewest < ENOUGH_SEEDS else ""


def _success(results: Results, arm: Arm, generator: np.random.Generator) -> tuple[float, str]:
    rates = scores(results[arm.name], "success_rate")
    estimate = interval(rates, generator)
    shown = " ".join(f"{rate:.2f}" for rate in rates)
    return estimate.value, f"{arm.label}: IQM success {_rate(estimate)}; by seed {shown}."


def _fails(arm: Arm) -> Callable[[Results, np.random.Generator], Verdict]:
    def decide(results: Results, generator: np.random.Generator) -> Verdict:
        value, text = _success(results, arm, generator)
        return value < FAILS_BELOW, text

    return decide


def _both_complete(results: Results, generator: np.random.Generator) -> Verdict:
    values, texts = zip(*(_success(results, arm, generator) for arm in (C01, C03)), strict=True)
    return min(values) >= COMPLETES_FROM, " ".join(texts)


def _fewer_steps(results: Results, generator: np.random.Generator) -> Verdict:
    lengths = {arm.label: scores(results[arm.name], "mean_success_length") for arm in (C03, C01)}
    without = [label for label, values in lengths.items() if not len(values)]
    if without:
        return False, f"No evaluation episode succeeded with {' or '.join(without)}."
    with_c03, with_c01 = lengths.values()
    estimate = difference(with_c03, with_c01, generator)
    parts = [f"{label}: {iqm(values):.0f} decisions over {len(values)} runs" for label, values in lengths.items()]
    return estimate.high < 0, f"{'; '.join(parts)}; difference {_number(estimate)}."


def _overwhelmed(results: Results, generator: np.random.Generator) -> Verdict:
    success, text = _success(results, C05, generator)
    length, base = (interval(scores(results[arm.name], "mean_episode_length"), generator) for arm in (C05, BASE))
    returned = interval(scores(results[C05.name], "mean_return"), generator)
    holds = success < OVERWHELMED_BELOW and length.value < QUICKLY_BELOW * base.value
    return holds, (
        f"{text} IQM length {_number(length)}, base PPO's {_number(base)} decisions; IQM return {_number(returned, 2)}."
    )


def _sooner_and_better(results: Results, generator: np.random.Generator) -> Verdict:
    runs = [results[arm.name] for arm in (C03, NO_PENALTY)]
    sooner, later = (steps_to(each, "steps_to_50_success") for each in runs)
    estimate = difference(sooner, later, generator)
    reached = [len(scores(each, "steps_to_50_success")) for each in runs]
    with_it, with_text = _success(results, C03, generator)
    without, without_text = _success(results, NO_PENALTY, generator)
    return estimate.high < 0 and with_it >= without, (
        f"Steps to 50% success, with minus without: {_number(estimate)}; reached by {reached[0]} of {len(runs[0])} "
        f"runs with it and {reached[1]} of {len(runs[1])} without. {with_text} {without_text}"
    )


def _shorter(results: Results, generator: np.random.Generator) -> Verdict:
    lengths = [scores(results[arm.name], "mean_episode_length") for arm in (C03, NO_PENALTY)]
    estimate = difference(lengths[0], lengths[1], generator)
    with_it, without = (f"{iqm(values):.0f}" for values in lengths)
    return estimate.high < 0, f"IQM length with {with_it}, without {without} decisions; difference {_number(estimate)}."


def _rate(estimate: Estimate) -> str:
    return f"{estimate.value:.3f} [{estimate.low:.3f}, {estimate.high:.3f}]"


def _number(estimate: Estimate, digits: int = 0) -> str:
    return f"{estimate.value:,.{digits}f} [{estimate.low:,.{digits}f}, {estimate.high:,.{digits}f}]"


CLAIMS = {
    claim.id: claim
    for claim in (
        Claim(
            "C1",
            "Base PPO, without intrinsic reward, is unable to complete the task.",
            f"c = 0: IQM of evaluation success < {FAILS_BELOW:g}",
            (BASE,),
            _fails(BASE),
        ),
        Claim(
            "C2",
            "With c = 0.1 and with c = 0.3 the agent completes the task.",
            f"c = 0.1 and c = 0.3: IQM of evaluation success >= {COMPLETES_FROM:g} each",
            (C01, C03),
            _both_complete,
        ),
        Claim(
            "C3",
            "The agent with c = 0.3 needs fewer steps to complete the task than the one with c = 0.1.",
            "mean length of successful evaluation episodes, c = 0.3 minus c = 0.1: 95% interval of the difference of "
            "IQMs is below 0 (runs without a success have no such length)",
            (C03, C01),
            _fewer_steps,
        ),
        Claim(
            "C4",
            "With c = 0.5 curiosity overwhelms the extrinsic reward: the return is low and episodes end quickly.",
            f"c = 0.5: IQM of evaluation success < {OVERWHELMED_BELOW:g}, and IQM of mean episode length below "
            f"{QUICKLY_BELOW:g} x base PPO's",
            (C05, BASE),
            _overwhelmed,
        ),
        Claim(
            "C5",
            "With the added penalty training starts at a lower return, but finds a solution sooner, and a better one.",
            "c = 0.3, steps to 50% success with the penalty minus without: 95% interval of the difference of IQMs is "
            "below 0 (a run that never gets there counts with all its steps); and IQM of evaluation success not lower",
            (C03, NO_PENALTY),
            _sooner_and_better,
        ),
        Claim(
            "C6",
            "With the added penalty, episodes are shorter at the end.",
            "c = 0.3, mean length of evaluation episodes with the penalty minus without: 95% interval of the "
            "difference of IQMs is below 0",
            (C03, NO_PENALTY),
            _shorter,
        ),
        Claim(
            "C7",
            "Base PPO without the penalty and without curiosity fails too.",
            f"c = 0 and no penalty: IQM of evaluation success < {FAILS_BELOW:g}",
            (BASE_NO_PENALTY,),
            _fails(BASE_NO_PENALTY),
        ),
    )
}

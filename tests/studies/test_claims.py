"""Each claim is decided by its measure, on results made by hand."""

from collections.abc import Callable

import pytest

from trainer.presets import preset_run
from trainer.studies.claims import CLAIMS
from trainer.studies.results import RunResult, curves, scores, steps_to


def run(
    success=0.0, length=300.0, success_length=None, to_50=None, c=0.3, seed=0, rows=(), steps=1_500_000, episodes=200
):
    evaluation = {
        "episodes": episodes,
        "success_rate": success,
        "mean_return": -2.0,
        "mean_episode_length": length,
        "mean_success_length": success_length,
    }
    summary = {"steps_to_50_success": to_50, "steps_to_90_success": None, "wall_seconds": 1.0, "evaluation": evaluation}
    return RunResult(preset_run(f"any-seed{seed}", "fast", c=c, seed=seed, steps=steps), summary, rows, "any")


def arm(count: int, of: Callable[[int], RunResult]) -> list[RunResult]:
    return [of(seed) for seed in range(count)]


def holds(claim: str, **arms: list[RunResult]) -> bool:
    names = {"base": "c0", "c01": "c0.1", "c03": "c0.3", "c05": "c0.5", "without": "c0.3-no-penalty"}
    names["base_without"] = "c0-no-penalty"
    return CLAIMS[claim].judge({names[name]: runs for name, runs in arms.items()})["holds"]


@pytest.mark.parametrize(("claim", "name"), [("C1", "base"), ("C7", "base_without")])
def test_base_ppo_fails_if_the_middle_of_its_seeds_does(claim, name):
    # two of ten seeds that solve it are outside the middle half
    assert holds(claim, **{name: arm(10, lambda seed: run(success=float(seed < 2)))})
    assert not holds(claim, **{name: arm(10, lambda seed: run(success=float(seed < 3)))})


def test_both_ratios_have_to_complete_the_task():
    good, fair = arm(10, lambda _: run(success=0.95)), arm(10, lambda _: run(success=0.85))
    assert holds("C2", c01=good, c03=good)
    assert not holds("C2", c01=good, c03=fair)
    assert not holds("C2", c01=fair, c03=good)


def test_fewer_steps_need_an_interval_below_0():
    def lengths(middle, spread):
        return arm(10, lambda seed: run(success=0.9, success_length=middle + spread * (seed - 4.5)))

    assert holds("C3", c03=lengths(80, 1), c01=lengths(100, 1))
    assert not holds("C3", c03=lengths(100, 1), c01=lengths(80, 1))
    assert not holds("C3", c03=lengths(98, 20), c01=lengths(100, 20))
    assert not holds("C3", c03=arm(10, lambda _: run()), c01=lengths(80, 1))


def test_overwhelmed_is_both_unsuccessful_and_quick():
    base = arm(10, lambda _: run(length=800))
    assert holds("C4", base=base, c05=arm(10, lambda _: run(success=0.4, length=399)))
    assert not holds("C4", base=base, c05=arm(10, lambda _: run(success=0.4, length=401)))
    assert not holds("C4", base=base, c05=arm(10, lambda _: run(success=0.5, length=100)))


def test_sooner_and_better_counts_a_run_that_never_gets_there_with_all_its_steps():
    soon = arm(10, lambda seed: run(success=0.95, to_50=200_000 + seed))
    never = arm(10, lambda _: run(success=0.0))
    assert holds("C5", c03=soon, without=never)
    assert not holds("C5", c03=never, without=soon)
    better = arm(10, lambda _: run(success=0.99, to_50=400_000))
    assert not holds("C5", c03=soon, without=better)


def test_shorter_episodes_at_the_end():
    long, short = (arm(10, lambda seed, middle=middle: run(length=middle + seed)) for middle in (300, 100))
    assert holds("C6", c03=short, without=long)
    assert not holds("C6", c03=long, without=short)
    assert not holds("C6", c03=long, without=long)


def test_a_claim_says_its_measure_and_its_numbers():
    judged = CLAIMS["C1"].judge({"c0": arm(10, lambda _: run(success=0.01))})
    assert list(judged) == ["id", "statement", "measure", "holds", "evidence"]
    assert "0.010 [0.010, 0.010]" in judged["evidence"]
    assert "Only" not in judged["evidence"]


def test_few_seeds_are_said():
    judged = CLAIMS["C1"].judge({"c0": arm(4, lambda _: run())})
    assert judged["holds"] is True
    assert judged["evidence"].endswith("Only 4 seeds; 10 are meant.")


@pytest.mark.parametrize(
    ("count", "options", "said"),
    [
        (3, {}, "3 of 4 seeds"),
        (10, {"steps": 20_000}, "20,000 of 1,500,000 steps per run"),
        (10, {"episodes": 59}, "59 of 60 episodes in an evaluation"),
        (1, {"steps": 1000}, "1 of 4 seeds, 1,000 of 1,500,000 steps per run"),
    ],
)
@pytest.mark.parametrize("claim", CLAIMS)
def test_no_claim_is_decided_by_less_than_its_measures_need(claim, count, options, said):
    results = {each.name: arm(count, lambda _: run(success_length=40.0, **options)) for each in CLAIMS[claim].arms}
    judged = CLAIMS[claim].judge(results)
    assert judged["holds"] is None
    assert judged["evidence"].startswith(f"Not decided: there are {said}. So far: ")
    enough = {each.name: arm(4, lambda _: run(success_length=40.0, episodes=60)) for each in CLAIMS[claim].arms}
    assert CLAIMS[claim].judge(enough)["holds"] is not None


def test_one_short_run_of_an_arm_is_too_little():
    runs = [*arm(9, lambda _: run()), run(steps=1_000_000)]
    assert CLAIMS["C7"].judge({"c0-no-penalty": runs})["holds"] is None


def test_without_runs_a_claim_is_not_decided():
    judged = CLAIMS["C2"].judge({"c0.1": arm(10, lambda _: run(success=1.0)), "c0.3": []})
    assert judged["holds"] is None
    assert judged["evidence"] == "Not decided: no finished run of c = 0.3."


def test_scores_leave_out_runs_without_one_and_steps_do_not():
    runs = [run(to_50=300), run(steps=1000)]
    assert scores(runs, "steps_to_50_success").tolist() == [300]
    assert steps_to(runs, "steps_to_50_success").tolist() == [300, 1000]


def test_curves_are_interpolated_where_every_run_has_values():
    def rows(*points):
        return [{"env_steps": float(step), "mean_return": value} for step, value in points]

    steps, values = curves(
        [run(rows=rows((0, None), (10, 1.0), (30, 3.0))), run(rows=rows((20, 5.0), (40, 5.0)))], "mean_return"
    )
    assert (steps[0], steps[-1]) == (20, 30)
    assert values[0, [0, -1]].tolist() == [2.0, 3.0]
    assert values[1, [0, -1]].tolist() == [5.0, 5.0]
    assert curves([run(rows=rows((0, None)))], "mean_return")[0].size == 0

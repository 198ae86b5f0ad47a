"""What a player does with the trainer's actions."""

import math
from typing import Any

from corridor_server.protocol.messages import OK
from trainer.conformance.session import Session, agents, deciding
from trainer.conformance.suite import Conformance, strict
from trainer.conformance.verdicts import NotApplicable, expect, expect_equal


class Actions(Conformance):
    """What a player does with the trainer's actions."""

    def test_the_game_goes_on_under_any_valid_actions(self) -> None:
        with self.playing(num_areas=2) as session:
            asked: dict[str, int] = {}
            for output in session.play(300):
                for name in session.specs:
                    asked[name] = asked.get(name, 0) + len(deciding(output, name))
            for name, count in asked.items():
                expect(count > 1, f"{name}'s agents asked {count} times in 300 messages", "more than one request")

    def test_a_mask_has_a_mark_for_each_choice_of_all_branches(self) -> None:
        with self.playing(num_areas=2) as session:
            for sizes, mask in _masks(session):
                expect_equal(len(mask), sum(sizes), "the number of marks in an action mask is")

    def test_a_mask_leaves_a_choice_in_every_branch(self) -> None:
        with self.playing(num_areas=2) as session:
            for sizes, mask in _masks(session):
                for branch, size in enumerate(sizes):
                    marks, mask = mask[:size], mask[size:]
                    expect(not marks or not all(marks), f"every choice of branch {branch} is forbidden", "one allowed")

    @strict
    def test_actions_in_the_deprecated_field_act_like_those_in_the_new_one(self) -> None:
        expect(
            self._after_ten(0.7) == self._after_ten(0.7, deprecated=True), "the agents are elsewhere", "the same place"
        )

    @strict
    def test_actions_beyond_1_act_like_1(self) -> None:
        with self.playing() as session:
            session.to_decisions()
            session.with_continuous_actions()
        expect(self._after_ten(1.0) == self._after_ten(50.0), "the agents are elsewhere", "the same place")

    @strict
    def test_actions_make_a_difference(self) -> None:
        one = self._after_ten(1.0)
        if one != self._after_ten(1.0):
            raise NotApplicable("the same seed and actions lead to other observations")
        expect(one != self._after_ten(-1.0), "opposite actions lead to the same observations", "a difference")

    @strict
    def test_a_nan_or_infinite_action_is_reported_and_never_simulated(self) -> None:
        for action in (math.nan, math.inf):
            with self.playing() as session:
                session.to_decisions()
                session.with_continuous_actions()
                self._is_refused(session, session.message(action))

    @strict
    def test_too_few_or_too_many_actions_are_reported(self) -> None:
        for surplus in (-1, 1):
            with self.playing(num_areas=2) as session:
                session.to_decisions()
                self._is_refused(session, session.wrong_count(surplus))

    @strict
    def test_actions_of_the_wrong_size_are_reported(self) -> None:
        for surplus in (-1, 1):
            with self.playing() as session:
                session.to_decisions()
                self._is_refused(session, session.wrong_size(surplus))

    def _is_refused(self, session: Session, message: Any) -> None:
        answer = session.trainer.ask(message)
        expect(answer.header.status != OK, "the player goes on with status 200", "another one")
        session.trainer.cut()
        expect(session.exit_code() != 0, "the player ended with code 0", "another one")

    def _after_ten(self, action: float, deprecated: bool = False) -> list[str]:
        with self.playing(seed=3) as session:
            for _ in range(10):
                session.step(action, deprecated=deprecated)
            return [str(info.observations) for info in agents(session.output)]


def _masks(session: Session) -> list[tuple[list[int], list[bool]]]:
    """The branches' sizes and the mask, for each request that has one.

    Raises:
        NotApplicable: There is none.
    """
    found = []
    for output in session.play(200):
        for name, parameters in session.specs.items():
            sizes = list(parameters.action_spec.discrete_branch_sizes)
            found += [(sizes, list(info.action_mask)) for info in deciding(output, name) if info.action_mask]
    if not found:
        discrete = any(parameters.action_spec.num_discrete_actions for parameters in session.specs.values())
        raise NotApplicable("no mask was seen" if discrete else "no behavior has discrete actions")
    return found

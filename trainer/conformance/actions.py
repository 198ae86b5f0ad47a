"""What a player does with the trainer's actions."""

from trainer.conformance.suite import Conformance, NotApplicable, agents, expect


class Actions(Conformance):
    """What a player does with the trainer's actions."""

    def test_actions_in_the_deprecated_field_act_like_those_in_the_new_one(self) -> None:
        seen = []
        for deprecated in (False, True):
            with self.playing(seed=3) as session:
                for _ in range(10):
                    session.step(0.7, deprecated=deprecated)
                seen.append([str(info.observations) for info in agents(session.output)])
        expect(seen[0] == seen[1], "the agents are elsewhere", "the same place")

    def test_actions_beyond_1_act_like_1(self) -> None:
        seen = []
        for action in (1.0, 50.0):
            with self.playing(seed=3) as session:
                for _ in range(10):
                    session.step(action)
                seen.append([str(info.observations) for info in agents(session.output)])
        expect(seen[0] == seen[1], "the agents are elsewhere", "the same place")

    def test_actions_make_a_difference(self) -> None:
        seen = []
        for action in (1.0, -1.0):
            with self.playing(seed=3) as session:
                for _ in range(10):
                    session.step(action)
                seen.append([str(info.observations) for info in agents(session.output)])
        if seen[0] == seen[1]:
            raise NotApplicable("opposite actions led to the same observations")

    def test_a_nan_or_infinite_action_is_reported_and_never_simulated(self) -> None:
        for action in (float("nan"), float("inf")):
            with self.playing() as session:
                session.step(0.5)
                session.trainer.reply(session.message(action))
                expect(session.exit_code() != 0, "the player ended with code 0", "another one")

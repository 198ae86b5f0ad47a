"""RESET, whenever it comes."""

from trainer.conformance.suite import Conformance, agents, deciding, ended, expect, expect_equal


class Reset(Conformance):
    """RESET, whenever it comes."""

    def test_a_reset_in_mid_episode_restarts_every_area_without_an_ended_agent(self) -> None:
        with self.playing(num_areas=3) as session:
            everyone = len(deciding(session.output))
            for _ in range(5):
                session.step(0.5)
            session.reset()
            expect(not ended(session.output), f"{len(ended(session.output))} agents ended", "none")
            expect_equal(len(deciding(session.output)), everyone, "the number of deciding agents is")
            rewards = [info.reward for info in deciding(session.output)]
            expect(not any(rewards), f"rewards {rewards}, from before the reset", "0")

    def test_a_hundred_resets_in_a_row_are_answered(self) -> None:
        with self.playing() as session:
            everyone = len(deciding(session.output))
            for _ in range(100):
                session.reset()
                expect_equal(len(deciding(session.output)), everyone, "the number of deciding agents is")

    def test_the_game_goes_on_after_a_reset(self) -> None:
        with self.playing() as session:
            session.reset()
            session.step(0.5)
            expect(agents(session.output), "no agents", "at least one")

    def test_a_step_before_the_first_reset_is_answered_with_agents(self) -> None:
        with self.connected() as session:
            session.trainer.handshake()
            session.step()
            expect(deciding(session.output), "no agents", "at least one")

"""RESET, whenever it comes."""

from trainer.conformance.suite import Conformance, agents, deciding, ended


class Reset(Conformance):
    """RESET, whenever it comes."""

    def test_a_reset_in_mid_episode_restarts_every_area_without_an_ended_agent(self) -> None:
        with self.playing(num_areas=3) as session:
            everyone = len(deciding(session.output))
            for _ in range(5):
                session.step(0.5)
            session.reset()
            assert not ended(session.output), f"{len(ended(session.output))} agents ended"
            assert len(deciding(session.output)) == everyone, f"{len(deciding(session.output))} agents of {everyone}"
            assert all(info.reward == 0.0 for info in deciding(session.output)), "rewards from before the reset"

    def test_a_hundred_resets_in_a_row_are_answered(self) -> None:
        with self.playing() as session:
            everyone = len(deciding(session.output))
            for _ in range(100):
                session.reset()
                assert len(deciding(session.output)) == everyone, "agents are missing"

    def test_the_game_goes_on_after_a_reset(self) -> None:
        with self.playing() as session:
            session.reset()
            session.step(0.5)
            assert agents(session.output), "no agents"

    def test_a_step_before_the_first_reset_is_answered_with_agents(self) -> None:
        with self.connected() as session:
            session.trainer.handshake()
            session.step()
            assert deciding(session.output), "no agents"

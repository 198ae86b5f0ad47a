"""RESET, whenever it comes."""

from trainer.conformance.session import Session, agents, deciding, ended
from trainer.conformance.suite import Conformance, strict
from trainer.conformance.verdicts import expect, expect_equal


class Reset(Conformance):
    """RESET, whenever it comes."""

    def test_a_reset_in_mid_episode_is_not_an_agents_end(self) -> None:
        """One that ends in the step in which the RESET arrives may be reported; not all of them, every time."""
        with self.playing(num_areas=3) as session:
            reported = []
            for _ in range(3):
                running = _running(session, messages=5)
                if running:
                    session.reset()
                    reported.append(sorted({info.id for info in ended(session.output)} & running))
            if reported:
                expect(not all(reported), f"after each reset, agents {reported} ended", "no ended agent")

    def test_every_agent_asks_again_after_a_reset_under_its_id(self) -> None:
        with self.playing(num_areas=3) as session:
            running = _running(session, messages=10)
            session.reset()
            seen: set[int] = set()
            for output in session.play(300):
                seen |= {info.id for info in agents(output)}
                if running <= seen:
                    break
            others = ", ".join(str(each) for each in sorted(seen - running)[:4]) or "none"
            for each in sorted(running):
                came = f"agent {each} asked before the reset and never after it (others that did: {others})"
                expect(each in seen, came, "the same id")

    def test_a_hundred_resets_in_a_row_are_answered(self) -> None:
        with self.playing() as session:
            for _ in range(100):
                expect(agents(session.reset()), "no agents", "at least one")

    def test_the_game_goes_on_after_a_reset(self) -> None:
        with self.playing() as session:
            session.reset()
            for _ in range(10):
                expect(deciding(session.to_decisions()), "nobody asks", "a request")
                session.step(0.5)
            expect(agents(session.output), "no agents", "at least one")

    @strict
    def test_a_reset_is_answered_at_once_by_all_agents_that_decide(self) -> None:
        with self.playing(num_areas=3) as session:
            everyone = len(deciding(session.output))
            for _ in range(100):
                session.step(0.5)
                session.reset()
                expect_equal(len(deciding(session.output)), everyone, "the number of deciding agents is")
                expect(not ended(session.output), f"{len(ended(session.output))} agents ended", "none")

    @strict
    def test_a_step_before_the_first_reset_is_answered_with_agents(self) -> None:
        with self.connected() as session:
            session.trainer.handshake()
            session.step()
            expect(deciding(session.output), "no agents", "at least one")


def _running(session: Session, messages: int) -> set[int]:
    """Plays, and returns the agents that are in an episode then."""
    running: set[int] = set()
    for output in session.play(messages):
        running -= {info.id for info in ended(output)}
        running |= {info.id for info in deciding(output)}
    return running

"""Agents, their ids, rewards and ends."""

from typing import Any

from trainer.conformance.session import agents, deciding, ended, until_an_episode_ends
from trainer.conformance.suite import Conformance, needs, strict
from trainer.conformance.verdicts import NotApplicable, expect, expect_equal


class Episodes(Conformance):
    """Agents, their ids, rewards and ends."""

    def test_every_message_has_an_agent_that_asks_or_has_ended(self) -> None:
        with self.playing(num_areas=4) as session:
            for number, output in enumerate(session.play(400)):
                expect(agents(output), f"message {number + 1} has no agents", "at least one")

    def test_no_agent_asks_twice_or_ends_twice_in_a_message(self) -> None:
        with self.playing(num_areas=4) as session:
            for output in session.play(400):
                for infos in (deciding(output), ended(output)):
                    ids = [info.id for info in infos]
                    for each in ids:
                        expect(ids.count(each) == 1, f"ids {sorted(ids)}", "each of them once")

    def test_an_agent_that_asked_asks_again_or_ends(self) -> None:
        """Not in every message: agents ask when they want to. Whoever is silent for half of them all has vanished."""
        with self.playing(num_areas=4) as session:
            outputs = [_ids(output) for output in session.play(400)]
            half = len(outputs) // 2
            running: set[int] = set()
            for asked, over in outputs[:half]:
                running = (running - over) | asked
            seen = {each for asked, over in outputs[half:] for each in asked | over}
            for each in sorted(running):
                expect(each in seen, f"agent {each} vanished without an ended message", "one")

    def test_an_agent_has_the_same_id_in_its_next_episode(self) -> None:
        with self.playing(num_areas=4) as session:
            known, over, newcomers, returned = set[int](), set[int](), set[int](), set[int]()
            for number, output in enumerate(session.play(3000)):
                asked, now_over = _ids(output)
                returned |= asked & over
                newcomers |= asked - known if over else set()
                known |= asked
                over |= now_over
                if len(returned) >= 3 or (returned and number > 300):
                    break
            if not over:
                raise NotApplicable("no episode ended under random actions")
            if not returned and not newcomers:
                raise NotApplicable("no agent asked after the first end")
            came = f"agents {_few(over)} ended and never asked again, others such as {_few(newcomers)} did"
            expect(returned, came, "the same id for each agent's next episode")

    def test_an_ended_agent_is_done_with_a_last_observation(self) -> None:
        with self.playing(num_areas=4) as session:
            for behavior in until_an_episode_ends(session).rl_output.agentInfos:
                kinds = {len(info.observations) for info in deciding(session.output, behavior)}
                for info in ended(session.output, behavior):
                    count = len(info.observations)
                    expect(count, f"agent {info.id} ended without an observation", "a last one")
                    same = not kinds or count in kinds
                    expect(same, f"agent {info.id} ended with {count} observations", f"{kinds}, as of the others,")

    @needs("end and next request of one agent in one message")
    def test_an_end_stands_before_the_same_agents_next_request(self) -> None:
        with self.playing(num_areas=4) as session:
            for output in session.play(1000):
                infos = agents(output)
                for place, info in enumerate(infos):
                    others = [each.id for each in infos if not each.done]
                    if info.done and info.id in others:
                        before = [each.id for each in infos[:place] if not each.done]
                        expect(info.id not in before, f"agent {info.id} asks and then ends", "the end first")

    def test_only_an_ended_agent_is_called_interrupted(self) -> None:
        with self.playing(num_areas=4) as session:
            for output in session.play(400):
                for info in deciding(output):
                    expect(not info.max_step_reached, f"the running agent {info.id} is called interrupted", "no mark")

    def test_an_agent_in_no_group_has_no_group_reward(self) -> None:
        with self.playing(num_areas=2) as session:
            for output in session.play(100):
                for info in agents(output):
                    expect(info.group_id >= 0, f"group id {info.group_id}", "one from 0 up")
                    if info.group_id == 0:
                        expect_equal(info.group_reward, 0.0, f"agent {info.id} is in no group, and its group reward is")

    @strict
    def test_the_ids_are_the_numbers_from_0(self) -> None:
        with self.playing(num_areas=4) as session:
            asked, _ = _ids(session.to_decisions())
            expect_equal(sorted(asked), list(range(len(asked))), "the ids are")

    @strict
    def test_a_request_in_the_message_of_the_last_end_has_reward_0(self) -> None:
        with self.playing(num_areas=4) as session:
            _, over = _ids(until_an_episode_ends(session))
            requests = [info for info in deciding(session.output) if info.id in over]
            if not requests:
                raise NotApplicable("the next request comes in a later message")
            expect_equal(len(requests), len(over), f"{len(over)} ended, and the number that ask again at once is")
            expect(not any(info.reward for info in requests), f"rewards {[info.reward for info in requests]}", "0")

    @strict
    def test_equal_seeds_give_equal_episodes(self) -> None:
        seen = []
        for _ in range(2):
            with self.playing(seed=5, num_areas=2) as session:
                outputs = [agents(output) for output in session.play(30)]
                seen.append([[(info.reward, str(info.observations)) for info in infos] for infos in outputs])
        expect(seen[0] == seen[1], "the same seed and actions gave other observations or rewards", "the same")


def _ids(output: Any) -> tuple[set[int], set[int]]:
    """Who asks in a message, and who ended."""
    return {info.id for info in deciding(output)}, {info.id for info in ended(output)}


def _few(ids: set[int]) -> str:
    return ", ".join(str(each) for each in sorted(ids)[:4])

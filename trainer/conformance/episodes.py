"""Agents, their ids, observations, rewards and ends."""

import numpy as np

from trainer.conformance.suite import (
    Conformance,
    NotApplicable,
    agents,
    all_finite,
    deciding,
    ended,
    expect,
    expect_equal,
    until_an_episode_ends,
)


class Episodes(Conformance):
    """Agents, their ids, observations, rewards and ends."""

    def test_ids_are_unique_within_a_message(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            ids = [info.id for info in agents(session.output)]
            expect(len(ids) == len(set(ids)), f"ids {sorted(ids)}", "each of them once")

    def test_every_episode_has_an_id_that_was_not_used_before(self) -> None:
        with self.playing(num_areas=4) as session:
            finished: set[int] = set()
            for _ in range(3):
                until_an_episode_ends(session)
                finished |= {info.id for info in ended(session.output)}
                reused = finished & {info.id for info in deciding(session.output)}
                expect(not reused, f"ids {sorted(reused)} are used again", "a new one for each episode")

    def test_an_agent_keeps_its_id_until_it_has_ended(self) -> None:
        with self.playing(num_areas=4) as session:
            generator = np.random.default_rng(0)
            running = {info.id for info in deciding(session.output)}
            for _ in range(400):
                session.step_randomly(generator)
                running -= {info.id for info in ended(session.output)}
                now = {info.id for info in deciding(session.output)}
                vanished = sorted(running - now)
                expect(not vanished, f"agents {vanished} vanished without an ended message", "one for each")
                running = now

    def test_an_ended_agent_is_done_with_a_last_observation(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            for info in ended(session.output):
                expect(info.observations, f"agent {info.id} ended without an observation", "a last one")

    def test_an_ended_agents_next_episode_begins_in_the_same_message_with_reward_0(self) -> None:
        with self.playing(num_areas=4) as session:
            before = {info.id for info in deciding(session.output)}
            generator = np.random.default_rng(0)
            for _ in range(3000):
                session.step_randomly(generator)
                if ended(session.output):
                    break
                before = {info.id for info in deciding(session.output)}
            else:
                raise NotApplicable("no episode ended under random actions")
            new = [info for info in deciding(session.output) if info.id not in before]
            if not new:
                raise NotApplicable("the next episode begins in a later message")
            over = len(ended(session.output))
            expect(len(new) == over, f"{over} ended, {len(new)} began", "one beginning for each end")
            rewards = [info.reward for info in new]
            expect(not any(rewards), f"first rewards {rewards}", "0")

    def test_an_end_without_a_step_limit_is_not_called_interrupted(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            cut = [info.id for info in ended(session.output) if info.max_step_reached]
            if cut and len(cut) == len(ended(session.output)):
                raise NotApplicable("the player's episodes end at a step limit")
            running = [info.id for info in deciding(session.output) if info.max_step_reached]
            expect(not running, f"the running agents {running} are called interrupted", "only an ended one")

    def test_observations_have_as_many_values_as_their_shape_says(self) -> None:
        with self.playing(num_areas=2) as session:
            generator = np.random.default_rng(0)
            for _ in range(20):
                for info in agents(session.output):
                    for observation in info.observations:
                        shape = list(observation.shape)
                        if observation.compression_type == 0:
                            count = len(observation.float_data.data)
                            expect(count == np.prod(shape), f"shape {shape} with {count} values", f"{np.prod(shape)}")
                        properties = len(observation.dimension_properties)
                        came = f"shape {shape} with {properties} dimension properties"
                        expect(properties in (0, len(shape)), came, "one for each axis, or none,")
                session.step_randomly(generator)

    def test_observations_keep_their_names_and_shapes(self) -> None:
        with self.playing(num_areas=2) as session:
            generator = np.random.default_rng(0)
            kinds = set()
            for _ in range(20):
                for info in agents(session.output):
                    kinds.add(tuple((each.name, tuple(each.shape)) for each in info.observations))
                session.step_randomly(generator)
            expect(len(kinds) == len(session.specs), f"seen: {sorted(kinds)}", "one kind for each behavior")

    def test_observations_and_rewards_are_finite(self) -> None:
        with self.playing(num_areas=2) as session:
            generator = np.random.default_rng(0)
            for _ in range(100):
                for info in agents(session.output):
                    values = [value for each in info.observations for value in each.float_data.data]
                    finite = all_finite([info.reward, info.group_reward, *values])
                    expect(finite, f"agent {info.id} has NaN or Inf", "a finite number")
                session.step_randomly(generator)

    def test_agents_in_no_group_have_group_id_and_reward_0(self) -> None:
        with self.playing(num_areas=2) as session:
            for info in agents(session.output):
                if info.group_id == 0:
                    expect_equal(info.group_reward, 0.0, "group reward")

    def test_rewards_are_0_in_the_first_message(self) -> None:
        with self.playing(num_areas=2) as session:
            rewards = [info.reward for info in agents(session.output)]
            expect(not any(rewards), f"rewards {rewards}", "0")

    def test_equal_seeds_give_equal_episodes(self) -> None:
        seen = []
        for _ in range(2):
            with self.playing(seed=5, num_areas=2) as session:
                generator = np.random.default_rng(0)
                messages = []
                for _ in range(30):
                    session.step_randomly(generator)
                    messages.append([(info.reward, str(info.observations)) for info in agents(session.output)])
                seen.append(messages)
        expect(seen[0] == seen[1], "the same seed and actions gave other observations or rewards", "the same")

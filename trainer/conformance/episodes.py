"""Agents, their ids, observations, rewards and ends."""

import numpy as np

from trainer.conformance.suite import (
    Conformance,
    NotApplicable,
    agents,
    all_finite,
    deciding,
    ended,
    until_an_episode_ends,
)


class Episodes(Conformance):
    """Agents, their ids, observations, rewards and ends."""

    def test_ids_are_unique_within_a_message(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            ids = [info.id for info in agents(session.output)]
            assert len(ids) == len(set(ids)), f"ids {sorted(ids)}"

    def test_every_episode_has_an_id_that_was_not_used_before(self) -> None:
        with self.playing(num_areas=4) as session:
            finished: set[int] = set()
            for _ in range(3):
                until_an_episode_ends(session)
                finished |= {info.id for info in ended(session.output)}
                reused = finished & {info.id for info in deciding(session.output)}
                assert not reused, f"ids {sorted(reused)} are used again"

    def test_an_agent_keeps_its_id_until_it_has_ended(self) -> None:
        with self.playing(num_areas=4) as session:
            generator = np.random.default_rng(0)
            running = {info.id for info in deciding(session.output)}
            for _ in range(400):
                session.step_randomly(generator)
                running -= {info.id for info in ended(session.output)}
                now = {info.id for info in deciding(session.output)}
                assert running <= now, f"agents {sorted(running - now)} vanished without an ended message"
                running = now

    def test_an_ended_agent_is_done_with_a_last_observation(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            for info in ended(session.output):
                assert info.observations, f"agent {info.id} ended without an observation"

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
            assert len(new) == len(ended(session.output)), f"{len(ended(session.output))} ended, {len(new)} began"
            assert all(info.reward == 0.0 for info in new), f"first rewards {[info.reward for info in new]}"

    def test_an_end_without_a_step_limit_is_not_called_interrupted(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            cut = [info.id for info in ended(session.output) if info.max_step_reached]
            if cut and len(cut) == len(ended(session.output)):
                raise NotApplicable("the player's episodes end at a step limit")
            assert all(not info.max_step_reached for info in deciding(session.output)), "a running agent is interrupted"

    def test_observations_have_as_many_values_as_their_shape_says(self) -> None:
        with self.playing(num_areas=2) as session:
            generator = np.random.default_rng(0)
            for _ in range(20):
                for info in agents(session.output):
                    for observation in info.observations:
                        if observation.compression_type == 0:
                            expected, came = int(np.prod(observation.shape)), len(observation.float_data.data)
                            assert came == expected, f"shape {list(observation.shape)} with {came} values"
                        assert len(observation.dimension_properties) in (0, len(observation.shape)), "properties"
                session.step_randomly(generator)

    def test_observations_keep_their_names_and_shapes(self) -> None:
        with self.playing(num_areas=2) as session:
            generator = np.random.default_rng(0)
            kinds = set()
            for _ in range(20):
                for info in agents(session.output):
                    kinds.add(tuple((each.name, tuple(each.shape)) for each in info.observations))
                session.step_randomly(generator)
            assert len(kinds) == len(session.specs), f"seen: {sorted(kinds)}"

    def test_observations_and_rewards_are_finite(self) -> None:
        with self.playing(num_areas=2) as session:
            generator = np.random.default_rng(0)
            for _ in range(100):
                for info in agents(session.output):
                    values = [value for each in info.observations for value in each.float_data.data]
                    assert all_finite([info.reward, info.group_reward, *values]), f"agent {info.id} has NaN or Inf"
                session.step_randomly(generator)

    def test_agents_in_no_group_have_group_id_and_reward_0(self) -> None:
        with self.playing(num_areas=2) as session:
            for info in agents(session.output):
                if info.group_id == 0:
                    assert info.group_reward == 0.0, f"group reward {info.group_reward}"

    def test_rewards_are_0_in_the_first_message(self) -> None:
        with self.playing(num_areas=2) as session:
            rewards = [info.reward for info in agents(session.output)]
            assert not any(rewards), f"rewards {rewards}"

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
        assert seen[0] == seen[1], "the same seed and actions gave other observations or rewards"

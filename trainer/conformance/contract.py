"""The corridor's own contract (docs/contract.md): what a player must offer to stand in for the paper's corridor."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor import observation as layout
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol import side_channels as channels
from trainer.conformance.channels import environment_parameter
from trainer.conformance.suite import (
    Conformance,
    NotApplicable,
    Session,
    agents,
    deciding,
    ended,
    until_an_episode_ends,
    vector,
)

BEHAVIOR = "Corridor?team=0"
STATISTICS = (
    "Corridor/Success",
    "Corridor/Switch Triggered",
    "Corridor/Opponent Contacts",
    "Corridor/Wall Contacts",
    "Corridor/Closest Approach",
    "Corridor/Episode Length",
)
DEFAULT = CorridorConfig()


class CorridorContract(Conformance):
    """The corridor's own contract (docs/contract.md)."""

    def test_the_behavior_is_corridor_team_0_with_two_continuous_actions(self) -> None:
        with self.playing() as session:
            assert list(session.specs) == [BEHAVIOR], f"behaviors {list(session.specs)}"
            spec = session.specs[BEHAVIOR].action_spec
            sizes = (spec.num_continuous_actions, spec.num_discrete_actions)
            assert sizes == (2, 0), f"{sizes[0]} continuous actions and {sizes[1]} discrete branches"

    def test_every_area_has_one_agent_that_decides_in_step(self) -> None:
        with self.playing(num_areas=3) as session:
            for _ in range(20):
                assert len(deciding(session.output)) == 3, f"{len(deciding(session.output))} of 3 agents decide"
                session.step(0.1)

    def test_the_vector_observation_has_8_plus_5_k_floats(self) -> None:
        with self.playing() as session:
            size = len(vector(self._first(session)))
            assert layout.is_size(size), f"{size} floats"

    def test_an_episode_begins_at_rest_with_the_switch_off_inside_the_corridor(self) -> None:
        with self.playing(num_areas=8) as session:
            for info in agents(session.output):
                self._is_a_start(vector(info))

    def test_a_reset_in_mid_episode_shows_a_new_start(self) -> None:
        with self.playing(num_areas=4) as session:
            for _ in range(10):
                session.step(1.0)
            session.reset()
            for info in agents(session.output):
                self._is_a_start(vector(info))

    def test_distances_are_those_of_the_positions(self) -> None:
        with self.playing(num_areas=4) as session:
            generator = np.random.default_rng(0)
            for _ in range(30):
                for info in agents(session.output):
                    seen = np.array(vector(info), dtype=float)
                    position, d_g = seen[layout.POSITION], seen[layout.GOAL_DISTANCE]
                    p_op, d_op = _opponent(seen)[layout.OPPONENT_POSITION], _opponent(seen)[layout.OPPONENT_DISTANCE]
                    goal, opponent = np.hypot(*(seen[layout.GOAL] - position)), np.hypot(*(p_op - position))
                    assert abs(goal - d_g) < 1e-3, f"d_g is {d_g:g}, positions say {goal:g}"
                    assert abs(opponent - d_op) < 1e-3, f"d_op is {d_op:g}, positions say {opponent:g}"
                session.step_randomly(generator)

    def test_action_0_moves_along_x_and_action_1_along_z(self) -> None:
        for action, axis in (([1.0, 0.0], 0), ([0.0, 1.0], 1)):
            with self.playing() as session:
                for _ in range(5):
                    session.act({BEHAVIOR: [action]})
                velocity = vector(self._first(session))[layout.VELOCITY]
                assert velocity[axis] > 0.01, f"action {action} gives velocity {velocity}"
                assert abs(velocity[1 - axis]) < 0.01, f"action {action} gives velocity {velocity}"

    def test_each_action_reaches_the_agent_that_asked_in_that_place(self) -> None:
        with self.playing(num_areas=4) as session:
            for _ in range(3):
                session.act({BEHAVIOR: [[1.0 if place % 2 else -1.0, 0.0] for place in range(4)]})
            signs = [vector(info)[layout.VELOCITY][0] > 0 for info in deciding(session.output)]
            assert signs == [False, True, False, True], f"agents went +x: {signs}"

    def test_velocity_is_the_change_of_position(self) -> None:
        with self.playing(seed=2) as session:
            before = _opponent(vector(self._first(session)))
            opponent_moves = []
            for _ in range(10):
                session.step(0.0)
                after = _opponent(vector(self._first(session)))
                moved = after[layout.OPPONENT_POSITION] - before[layout.OPPONENT_POSITION]
                opponent_moves.append(np.abs(moved / 0.1 - after[layout.OPPONENT_VELOCITY]).max())
                before = after
            assert min(opponent_moves) < 0.01, "V_op is not (change of p_op) / 0.1 s"

    def test_the_opponent_goes_straight(self) -> None:
        with self.playing(seed=2) as session:
            headings = []
            for _ in range(15):
                session.step(0.0)
                headings.append(_opponent(vector(self._first(session)))[layout.OPPONENT_VELOCITY])
            assert np.ptp(headings, axis=0).max() < 0.01, "V_op changes on the way"

    def test_a_step_far_from_everything_costs_a_thousandth(self) -> None:
        with self.playing(seed=1) as session:
            for number in range(5):
                session.step(0.0)
                reward = self._first(session).reward
                assert abs(reward + 0.001) < 1e-6, f"reward {reward:g} at step {number + 1}"

    def test_pushing_into_a_wall_costs_a_tenth(self) -> None:
        with self.playing(seed=1) as session:
            rewards = []
            for _ in range(60):
                session.act({BEHAVIOR: [[-1.0, 0.0]]})
                if ended(session.output):
                    break
                rewards.append(self._first(session).reward)
            assert any(abs(reward + 0.1) < 1e-6 for reward in rewards), f"rewards {sorted(set(rewards))}"

    def test_rewards_are_those_of_the_table(self) -> None:
        """While it runs, an episode's rewards are -0.001, -0.1, -0.25 or the near zone's."""
        with self.playing(seed=4, num_areas=8) as session:
            generator = np.random.default_rng(0)
            for _ in range(200):
                session.step_randomly(generator)
                new = {info.id for info in deciding(session.output)}
                for info in deciding(session.output):
                    if info.id in new and not info.reward:
                        continue
                    near = -0.1 - (1.0 - _opponent(vector(info))[layout.OPPONENT_DISTANCE]) / 4.0
                    table = (-0.001, -0.1, -0.25, near)
                    assert min(abs(info.reward - each) for each in table) < 1e-4, f"reward {info.reward:g}"

    def test_a_failed_episode_pays_the_penalty_with_its_last_reward(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            for info in ended(session.output):
                if info.max_step_reached:
                    raise NotApplicable("the episode was interrupted")
                good = abs(info.reward - 1.0) < 1e-4 or info.reward <= -1.0
                assert good, f"the last reward is {info.reward:g}; +1, or -1 and the step's own, was expected"

    def test_the_failure_penalty_can_be_switched_off_over_the_side_channel(self) -> None:
        with self.playing(num_areas=4, side_channel=environment_parameter("failure_penalty", 0.0)) as session:
            until_an_episode_ends(session)
            for info in ended(session.output):
                assert info.reward > -0.5, f"the last reward is {info.reward:g}"

    def test_a_parameter_takes_effect_at_the_next_reset(self) -> None:
        with self.playing(side_channel=environment_parameter("goal_x", 5.0)) as session:
            goal = vector(self._first(session))[layout.GOAL][0]
            assert abs(goal - 5.0 / DEFAULT.half_length) < 1e-3, f"p_g is at {goal:g}"

    def test_statistics_come_with_every_ended_episode(self) -> None:
        with self.playing(num_areas=4) as session:
            until_an_episode_ends(session)
            keys = [
                payload[4 : 4 + int.from_bytes(payload[:4], "little")].decode()
                for channel, payload in channels.split(session.output.rl_output.side_channel)
                if channel == channels.STATISTICS
            ]
            for name in STATISTICS:
                count = keys.count(name)
                assert count == len(ended(session.output)), f"{name}: {count} for {len(ended(session.output))} ends"

    def test_other_seeds_and_areas_begin_elsewhere(self) -> None:
        starts = set()
        for seed in (1, 2):
            with self.playing(seed=seed, num_areas=2) as session:
                starts |= {tuple(vector(info)) for info in agents(session.output)}
        assert len(starts) == 4, f"{len(starts)} different starts of 4"

    @staticmethod
    def _first(session: Session) -> Any:
        return deciding(session.output)[0]

    @staticmethod
    def _is_a_start(seen: list[float]) -> None:
        (x, z), velocity, switch = seen[layout.POSITION], seen[layout.VELOCITY], seen[layout.SWITCH]
        assert velocity == [0.0, 0.0], f"velocity {velocity} at the start"
        assert switch == 0.0, f"sw_ind is {switch:g} at the start"
        spawn = [edge / DEFAULT.half_length for edge in DEFAULT.agent_spawn_x]
        assert spawn[0] - 1e-6 <= x <= spawn[1] + 1e-6, f"x = {x:g} is out of [{spawn[0]}, {spawn[1]}]"
        side = DEFAULT.spawn_z / DEFAULT.half_length + 1e-6
        assert abs(z) <= side, f"z = {z:g} is out of +-{side:g}"
        goal_x = seen[layout.GOAL][0]
        assert abs(goal_x - DEFAULT.goal_x / DEFAULT.half_length) < 1e-6, f"the target's x is {goal_x:g}"


def _opponent(seen: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """The first opponent's block."""
    block: NDArray[np.float64] = layout.opponent_blocks(np.asarray(seen, dtype=np.float64))[0]
    return block

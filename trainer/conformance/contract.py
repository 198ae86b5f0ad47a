"""The corridor's own contract (docs/contract.md): what a player must offer to stand in for the paper's corridor."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor import observation as layout
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.protocol import side_channels as channels
from trainer.conformance.channels import environment_parameter
from trainer.conformance.session import Session, agents, deciding, ended, until_an_episode_ends, vector
from trainer.conformance.suite import Conformance
from trainer.conformance.verdicts import NotApplicable, expect, expect_equal

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
        with self._deciding() as session:
            expect_equal(list(session.specs), [BEHAVIOR], "behaviors")
            spec = session.specs[BEHAVIOR].action_spec
            sizes = (spec.num_continuous_actions, spec.num_discrete_actions)
            came = f"{sizes[0]} continuous actions and {sizes[1]} discrete branches"
            expect(sizes == (2, 0), came, "2 and 0")

    def test_every_area_has_one_agent_that_decides_in_step(self) -> None:
        with self._deciding(num_areas=3) as session:
            for _ in range(20):
                count = len(deciding(session.to_decisions()))
                expect(count == 3, f"{count} of 3 agents decide", "a decision of each")
                session.step(0.1)

    def test_the_vector_observation_has_8_plus_5_k_floats(self) -> None:
        with self._deciding() as session:
            size = len(vector(self._first(session)))
            expect(layout.is_size(size), f"{size} floats", "8 + 5K with K of at least 1")

    def test_an_episode_begins_at_rest_with_the_switch_off_inside_the_corridor(self) -> None:
        with self._deciding(num_areas=8) as session:
            for info in deciding(session.output):
                self._is_a_start(vector(info))

    def test_a_reset_in_mid_episode_shows_a_new_start(self) -> None:
        with self._deciding(num_areas=4) as session:
            for _ in range(10):
                session.step(1.0)
            session.reset()
            for info in deciding(session.to_decisions()):
                self._is_a_start(vector(info))

    def test_distances_are_those_of_the_positions(self) -> None:
        with self._deciding(num_areas=4) as session:
            for output in session.play(30):
                for info in agents(output):
                    seen = np.array(vector(info), dtype=float)
                    position, d_g = seen[layout.POSITION], seen[layout.GOAL_DISTANCE]
                    p_op, d_op = _opponent(seen)[layout.OPPONENT_POSITION], _opponent(seen)[layout.OPPONENT_DISTANCE]
                    goal, opponent = np.hypot(*(seen[layout.GOAL] - position)), np.hypot(*(p_op - position))
                    expect(abs(goal - d_g) < 1e-3, f"d_g is {d_g:g}", f"the positions' {goal:g}")
                    expect(abs(opponent - d_op) < 1e-3, f"d_op is {d_op:g}", f"the positions' {opponent:g}")

    def test_action_0_moves_along_x_and_action_1_along_z(self) -> None:
        for action, axis in (([1.0, 0.0], 0), ([0.0, 1.0], 1)):
            with self._deciding() as session:
                for _ in range(5):
                    session.act({BEHAVIOR: [action]})
                    session.to_decisions()
                velocity = vector(self._first(session))[layout.VELOCITY]
                good = velocity[axis] > 0.01 and abs(velocity[1 - axis]) < 0.01
                expect(good, f"action {action} gives velocity {velocity}", f"one along +{'xz'[axis]} alone")

    def test_each_action_reaches_the_agent_that_asked_in_that_place(self) -> None:
        with self._deciding(num_areas=4) as session:
            self._has_areas(session, 4)
            for _ in range(3):
                session.act({BEHAVIOR: [[1.0 if place % 2 else -1.0, 0.0] for place in range(4)]})
                session.to_decisions()
            signs = [vector(info)[layout.VELOCITY][0] > 0 for info in deciding(session.output)]
            expect_equal(signs, [False, True, False, True], "agents went +x:")

    def test_velocity_is_the_change_of_position(self) -> None:
        with self._deciding(seed=2) as session:
            before = _opponent(vector(self._first(session)))
            opponent_moves = []
            for _ in range(10):
                session.step(0.0)
                session.to_decisions()
                after = _opponent(vector(self._first(session)))
                moved = after[layout.OPPONENT_POSITION] - before[layout.OPPONENT_POSITION]
                opponent_moves.append(np.abs(moved / 0.1 - after[layout.OPPONENT_VELOCITY]).max())
                before = after
            least = min(opponent_moves)
            expect(least < 0.01, f"V_op is off (change of p_op) / 0.1 s by {least:g}", "no difference")

    def test_the_opponent_goes_straight(self) -> None:
        with self._deciding(seed=2) as session:
            headings = []
            for _ in range(15):
                session.step(0.0)
                session.to_decisions()
                headings.append(_opponent(vector(self._first(session)))[layout.OPPONENT_VELOCITY])
            change = np.ptp(headings, axis=0).max()
            expect(change < 0.01, f"V_op changes on the way by {change:g}", "no change")

    def test_a_step_far_from_everything_costs_a_thousandth(self) -> None:
        with self._deciding(seed=1) as session:
            for number in range(5):
                session.step(0.0)
                session.to_decisions()
                reward = self._first(session).reward
                expect(abs(reward + 0.001) < 1e-6, f"reward {reward:g} at step {number + 1}", "-0.001")

    def test_pushing_into_a_wall_costs_a_tenth(self) -> None:
        with self._deciding(seed=1) as session:
            rewards = []
            for _ in range(60):
                session.act({BEHAVIOR: [[-1.0, 0.0]]})
                if ended(session.output):
                    break
                rewards.append(self._first(session).reward)
            walls = [reward for reward in rewards if abs(reward + 0.1) < 1e-6]
            expect(walls, f"rewards {sorted(set(rewards))}", "at least one of -0.1")

    def test_rewards_are_those_of_the_table(self) -> None:
        """While it runs, an episode's rewards are -0.001, -0.1, -0.25 or the near zone's."""
        with self._deciding(seed=4, num_areas=8) as session:
            for output in session.play(200):
                for info in deciding(output):
                    if not info.reward:  # an episode's first request
                        continue
                    near = -0.1 - (1.0 - _opponent(vector(info))[layout.OPPONENT_DISTANCE]) / 4.0
                    table = (-0.001, -0.1, -0.25, near)
                    known = min(abs(info.reward - each) for each in table) < 1e-4
                    expect(known, f"reward {info.reward:g}", f"one of {', '.join(f'{each:g}' for each in table)}")

    def test_an_episode_ends_when_its_rewards_add_up_to_minus_1(self) -> None:
        with self._deciding(seed=1) as session:
            total = 0.0
            for _ in range(300):
                session.act({BEHAVIOR: [[-1.0, 0.0]]})
                if ended(session.output):
                    return
                total += self._first(session).reward
                expect(total > -1.0 + 1e-4, f"an episode goes on with rewards of {total:g} in all", "its end")
            raise NotApplicable(f"300 steps towards the wall earned {total:g}")

    def test_a_failed_episode_pays_the_penalty_with_its_last_reward(self) -> None:
        with self._deciding(num_areas=4) as session:
            until_an_episode_ends(session)
            for info in ended(session.output):
                if info.max_step_reached:
                    raise NotApplicable("the episode was interrupted")
                good = abs(info.reward - 1.0) < 1e-4 or info.reward <= -1.0
                expect(good, f"the last reward is {info.reward:g}", "+1, or -1 and the step's own,")

    def test_the_failure_penalty_can_be_switched_off_over_the_side_channel(self) -> None:
        with self._deciding(num_areas=4, side_channel=environment_parameter("failure_penalty", 0.0)) as session:
            until_an_episode_ends(session)
            for info in ended(session.output):
                expect(info.reward > -0.5, f"the last reward is {info.reward:g}", "one without the penalty")

    def test_a_parameter_takes_effect_at_the_next_reset(self) -> None:
        with self._deciding(side_channel=environment_parameter("goal_x", 5.0)) as session:
            goal = vector(self._first(session))[layout.GOAL][0]
            asked = 5.0 / DEFAULT.half_length
            expect(abs(goal - asked) < 1e-3, f"p_g is at {goal:g}", f"{asked:g}")

    def test_statistics_come_with_every_ended_episode(self) -> None:
        with self._deciding(num_areas=4) as session:
            until_an_episode_ends(session)
            keys = [
                payload[4 : 4 + int.from_bytes(payload[:4], "little")].decode()
                for channel, payload in channels.split(session.output.rl_output.side_channel)
                if channel == channels.STATISTICS
            ]
            for name in STATISTICS:
                count, ends = keys.count(name), len(ended(session.output))
                expect(count == ends, f"{name}: {count} for {ends} ends", "one for each")

    def test_other_seeds_and_areas_begin_elsewhere(self) -> None:
        starts = set()
        for seed in (1, 2):
            with self._deciding(seed=seed, num_areas=2) as session:
                self._has_areas(session, 2)
                starts |= {tuple(vector(info)) for info in deciding(session.output)}
        expect(len(starts) == 4, f"{len(starts)} different starts of 4", "another one for each")

    @contextmanager
    def _deciding(self, seed: int = 0, num_areas: int = 1, side_channel: bytes = b"") -> Iterator[Session]:
        """A player after the first RESET, where the first agents decide: not all timings have them in its answer."""
        with self.playing(seed=seed, num_areas=num_areas, side_channel=side_channel) as session:
            session.to_decisions()
            yield session

    @staticmethod
    def _has_areas(session: Session, asked: int) -> None:
        came = len(deciding(session.output))
        if came != asked:
            raise NotApplicable(f"{came} of {asked} areas came, which another sentence is about")

    @staticmethod
    def _first(session: Session) -> Any:
        return deciding(session.output)[0]

    @staticmethod
    def _is_a_start(seen: list[float]) -> None:
        (x, z), velocity, switch = seen[layout.POSITION], seen[layout.VELOCITY], seen[layout.SWITCH]
        expect_equal(velocity, [0.0, 0.0], "at the start, the velocity is")
        expect_equal(switch, 0.0, "at the start, sw_ind is")
        spawn = [edge / DEFAULT.half_length for edge in DEFAULT.agent_spawn_x]
        inside = spawn[0] - 1e-6 <= x <= spawn[1] + 1e-6
        expect(inside, f"x = {x:g} at the start", f"one in [{spawn[0]}, {spawn[1]}]")
        side = DEFAULT.spawn_z / DEFAULT.half_length + 1e-6
        expect(abs(z) <= side, f"z = {z:g} at the start", f"one in +-{side:g}")
        goal_x, expected_x = seen[layout.GOAL][0], DEFAULT.goal_x / DEFAULT.half_length
        expect(abs(goal_x - expected_x) < 1e-6, f"the target's x is {goal_x:g}", f"{expected_x:g}")


def _opponent(seen: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """The first opponent's block."""
    block: NDArray[np.float64] = layout.opponent_blocks(np.asarray(seen, dtype=np.float64))[0]
    return block

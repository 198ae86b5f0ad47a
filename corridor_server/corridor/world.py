"""The paper's corridor as pure functions over arrays (sections III-C, III-D and IV).

Every array has a leading axis of A areas, which never meet. ``Parameters`` maps a parameter's name to one float64 per
area, so that areas may differ. Positions are (x, z) in metres: x runs along the corridor, z across it. All arithmetic
is element-wise float64, so an area's numbers do not depend on how many areas there are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from corridor_server.corridor import observation as layout
from corridor_server.corridor.arrays import Bools, Counts, Floats, Parameters
from corridor_server.corridor.reward import step_reward

ACTION_SIZE = 2
# A thousand steps of -0.001 add up to just above -1 in floating point, and must end the episode all the same.
RETURN_TOLERANCE = 1e-9


@dataclass(frozen=True)
class State:
    """Where everything is, for A areas with K opponents each.

    Attributes:
        position: The agents' centres, (A, 2) m.
        velocity: (A, 2) m/s.
        goal: The agents' targets, (A, 2) m.
        switch_on: (A,).
        opponent_position: (A, K, 2) m.
        opponent_velocity: (A, K, 2) m/s.
        opponent_target: Hidden from the agent (eq. 8), (A, K, 2) m.
        episode_return: Accumulated reward of the running episode, without the failure penalty, (A,).
        episode_steps: Decisions since the episode began, (A,).
        opponent_contacts: Decisions of this episode that ended in touch with an opponent, (A,).
        wall_contacts: Decisions of this episode that pushed the agent into a wall, (A,).
        closest_approach: Least d_opp of this episode, (A,) half-lengths.
    """

    position: Floats
    velocity: Floats
    goal: Floats
    switch_on: Bools
    opponent_position: Floats
    opponent_velocity: Floats
    opponent_target: Floats
    episode_return: Floats
    episode_steps: Counts
    opponent_contacts: Counts
    wall_contacts: Counts
    closest_approach: Floats

    @classmethod
    def empty(cls, areas: int, opponents: int) -> "State":
        """A state of zeros, to merge episodes into."""
        one, count, pair, pairs = np.zeros(areas), np.zeros(areas, np.int64), (areas, 2), (areas, opponents, 2)
        return cls(
            position=np.zeros(pair),
            velocity=np.zeros(pair),
            goal=np.zeros(pair),
            switch_on=np.zeros(areas, np.bool_),
            opponent_position=np.zeros(pairs),
            opponent_velocity=np.zeros(pairs),
            opponent_target=np.zeros(pairs),
            episode_return=one,
            episode_steps=count,
            opponent_contacts=count,
            wall_contacts=count,
            closest_approach=one,
        )

    def merged(self, areas: NDArray[np.intp], other: "State") -> "State":
        """This state with the given areas' rows taken, in order, from ``other``."""
        columns = {}
        for column in fields(self):
            columns[column.name] = getattr(self, column.name).copy()
            columns[column.name][areas] = getattr(other, column.name)
        return State(**columns)


@dataclass(frozen=True)
class Outcome:
    """What one decision led to, each (A,).

    Attributes:
        reward: Eq. 9, and the failure penalty where the episode failed.
        success: The goal was reached with the switch on (terminated).
        failed: Accumulated reward reached ``failure_return`` (terminated).
        truncated: The step limit, where one is set, cut the episode.
    """

    reward: Floats
    success: Bools
    failed: Bools
    truncated: Bools

    @property
    def ended(self) -> Bools:
        """Where the episode is over, for whatever reason."""
        return self.success | self.failed | self.truncated


def initial(p: Parameters, num_opponents: int, generators: Sequence[np.random.Generator]) -> State:
    """Draws a new episode for each area from that area's own generator.

    Starts and targets are drawn uniformly and then kept inside the walls, whatever the parameters.
    """
    areas = len(generators)
    # One draw of fixed length per episode; an opponent's part comes last, so that K does not shift the rest.
    u = np.stack([generator.random(3 + 3 * num_opponents) for generator in generators])
    of_opponents = u[:, 3:].reshape(areas, num_opponents, 3)
    each = {name: column[:, None] for name, column in p.items()}

    limit, opponent_limit = _centre_limits(p, p["agent_radius"]), _centre_limits(p, p["opponent_radius"])[:, None]
    position = _limited(
        _pairs(_between(p["agent_spawn_x_min"], p["agent_spawn_x_max"], u[:, 0]), _within(p["spawn_z"], u[:, 1])),
        limit,
    )
    goal = _limited(_pairs(p["goal_x"], _within(p["goal_z"], u[:, 2])), limit)
    opponent_position = _limited(
        _pairs(
            _between(each["opponent_spawn_x_min"], each["opponent_spawn_x_max"], of_opponents[..., 0]),
            _within(each["spawn_z"], of_opponents[..., 1]),
        ),
        opponent_limit,
    )
    opponent_target = _limited(
        _pairs(each["opponent_target_x"], _within(each["opponent_target_z"], of_opponents[..., 2])), opponent_limit
    )
    return State(
        position=position,
        velocity=np.zeros((areas, 2)),
        goal=goal,
        switch_on=_in_switch(p, position),
        opponent_position=opponent_position,
        opponent_velocity=_toward(each["opponent_speed"], opponent_target - opponent_position)[0],
        opponent_target=opponent_target,
        episode_return=np.zeros(areas),
        episode_steps=np.zeros(areas, np.int64),
        opponent_contacts=np.zeros(areas, np.int64),
        wall_contacts=np.zeros(areas, np.int64),
        closest_approach=_nearest(position, opponent_position) / p["half_length"],
    )


def step(p: Parameters, state: State, action: Floats) -> tuple[State, Outcome]:
    """One decision in every area: motion, contacts, eq. 9's reward and the episode's end.

    Args:
        p: Parameters, one value per area.
        state: Where everything is.
        action: (A, 2), expected in [-1, 1] and clipped to it.

    Returns:
        The next state (of the same episodes, ended ones included) and what happened.
    """
    seconds = p["decision_seconds"]
    position, velocity, wall_contact = _move_agent(p, state, _limited(action, 1.0))

    to_target = state.opponent_target - state.opponent_position
    heading, distance = _toward(p["opponent_speed"][:, None], to_target)
    arrives = distance <= (p["opponent_speed"] * seconds)[:, None]
    opponent_position = np.where(
        arrives[..., None], state.opponent_target, state.opponent_position + heading * seconds[:, None, None]
    )
    opponent_velocity = np.where(arrives[..., None], 0.0, heading)

    switch_on = state.switch_on | _in_switch(p, position)
    apart = _nearest(position, opponent_position)
    d_opp = apart / p["half_length"]
    opponent_contact = apart <= p["agent_radius"] + p["opponent_radius"]
    success = switch_on & (_length(state.goal - position) <= p["goal_radius"])

    reward = step_reward(p, success, wall_contact, opponent_contact, d_opp)
    episode_return = state.episode_return + reward
    episode_steps = state.episode_steps + 1
    failed = ~success & (episode_return <= p["failure_return"] + RETURN_TOLERANCE)
    truncated = ~success & ~failed & (p["max_episode_steps"] > 0) & (episode_steps >= p["max_episode_steps"])

    moved = State(
        position=position,
        velocity=velocity,
        goal=state.goal,
        switch_on=switch_on,
        opponent_position=opponent_position,
        opponent_velocity=opponent_velocity,
        opponent_target=state.opponent_target,
        episode_return=episode_return,
        episode_steps=episode_steps,
        opponent_contacts=state.opponent_contacts + opponent_contact,
        wall_contacts=state.wall_contacts + wall_contact,
        closest_approach=np.minimum(state.closest_approach, d_opp),
    )
    outcome = Outcome(
        reward=reward - np.where(failed, p["failure_penalty"], 0.0),
        success=success,
        failed=failed,
        truncated=truncated,
    )
    return moved, outcome


def observation(p: Parameters, state: State) -> NDArray[np.float32]:
    """Eq. 10's agent-centric state, (A, 8 + 5K) float32, with eq. 8 for each opponent; in the units of ``layout``."""
    areas, opponents, _ = state.opponent_position.shape
    scale = p["half_length"][:, None]
    result = np.empty((areas, layout.size(opponents)), dtype=np.float32)
    result[:, layout.POSITION] = state.position / scale
    result[:, layout.VELOCITY] = state.velocity / scale
    result[:, layout.GOAL] = state.goal / scale
    result[:, layout.GOAL_DISTANCE] = _length(state.goal - state.position) / p["half_length"]
    result[:, layout.SWITCH] = state.switch_on
    each = layout.opponent_blocks(result)
    each[..., layout.OPPONENT_POSITION] = state.opponent_position / scale[..., None]
    each[..., layout.OPPONENT_DISTANCE] = _length(state.opponent_position - state.position[:, None]) / scale
    each[..., layout.OPPONENT_VELOCITY] = state.opponent_velocity / scale[..., None]
    return result


def statistics(state: State, outcome: Outcome) -> dict[str, Floats]:
    """What is reported of an episode when it ends, each (A,), for the areas in which it does."""
    return {
        "Success": outcome.success.astype(np.float64),
        "Switch Triggered": state.switch_on.astype(np.float64),
        "Opponent Contacts": state.opponent_contacts.astype(np.float64),
        "Wall Contacts": state.wall_contacts.astype(np.float64),
        "Closest Approach": state.closest_approach,
        "Episode Length": state.episode_steps.astype(np.float64),
    }


def _nearest(position: Floats, opponent_position: Floats) -> Floats:
    result: Floats = _length(opponent_position - position[:, None]).min(axis=1)
    return result


def _move_agent(p: Parameters, state: State, action: Floats) -> tuple[Floats, Floats, Bools]:
    """Solves dv/dt = (speed x action - v) / time constant over one decision; an axis that meets a wall is stopped."""
    seconds, lag, decay = (p[name][:, None] for name in ("decision_seconds", "agent_time_constant", "velocity_decay"))
    wanted = p["agent_speed"][:, None] * action
    excess = state.velocity - wanted
    velocity = wanted + excess * decay
    position = state.position + wanted * seconds + excess * (lag * (1.0 - decay))
    limit = _centre_limits(p, p["agent_radius"])
    beyond = np.abs(position) > limit
    stopped: Floats = np.where(beyond, 0.0, velocity)
    return _limited(position, limit), stopped, beyond[:, 0] | beyond[:, 1]


def _toward(speed: Floats, offset: Floats) -> tuple[Floats, Floats]:
    """Velocity of the given speed along each offset (zero where there is none), and the offset's length."""
    distance = _length(offset)
    return offset * (speed / np.where(distance > 0.0, distance, 1.0))[..., None], distance


def _in_switch(p: Parameters, position: Floats) -> Bools:
    return _length(_pairs(p["switch_x"], p["switch_z"]) - position) <= p["switch_radius"]


def _centre_limits(p: Parameters, radius: Floats) -> Floats:
    """How far from the origin a centre can be along x and z, (A, 2) m."""
    return np.maximum(_pairs(p["half_length"] - radius, p["half_width"] - radius), 0.0)


def _pairs(x: Floats, z: Floats) -> Floats:
    """(..., 2) of coordinates that have, or extend to, one shape: z's."""
    result = np.empty((*z.shape, 2))
    result[..., 0], result[..., 1] = x, z
    return result


def _limited(values: Floats, limit: Floats | float) -> Floats:
    """Values kept within +-limit: ``np.clip``, whose checks take longer than its work here."""
    result: Floats = np.minimum(np.maximum(values, -limit), limit)
    return result


def _length(offset: Floats) -> Floats:
    x, z = offset[..., 0], offset[..., 1]
    result: Floats = np.sqrt(x * x + z * z)
    return result


def _between(low: Floats, high: Floats, u: Floats) -> Floats:
    return low + (high - low) * u


def _within(bound: Floats, u: Floats) -> Floats:
    return bound * (2.0 * u - 1.0)

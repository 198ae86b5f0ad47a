"""Eq. 9: the reward of a step, from what happened in it."""

import numpy as np

from corridor_server.corridor.arrays import Bools, Floats, Parameters


def step_reward(p: Parameters, success: Bools, wall_contact: Bools, opponent_contact: Bools, d_opp: Floats) -> Floats:
    """The first case of eq. 9 that applies (``np.select``, which takes three times as long).

    Args:
        p: Parameters, one value per area.
        success: The target was reached with the switch on, (A,).
        wall_contact: The step pushed the agent into a wall, (A,).
        opponent_contact: Agent and an opponent touch, (A,).
        d_opp: Distance to the nearest opponent, centre to centre, (A,) half-lengths.

    Returns:
        (A,), without the failure penalty, which is the episode's.
    """
    cases = (
        (success, p["goal_reward"]),
        (wall_contact, -p["wall_penalty"]),
        (opponent_contact, -p["contact_penalty"]),
        (d_opp < p["near_distance"], -p["near_penalty"] - (1.0 - d_opp) / 4.0),
    )
    reward = -p["step_penalty"]
    for applies, value in reversed(cases):
        reward = np.where(applies, value, reward)
    return reward

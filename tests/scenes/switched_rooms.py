#!/usr/bin/env python3
"""Rooms with switches: what Unity's Pyramids asks of a trainer, with its sizes (172 floats, five choices, few rewards).

Whoever runs into a room's switch finds itself in the next room, and in the last room makes a goal appear instead, which
pays 2 and ends the episode. Every decision costs 1 / ``MOST_STEPS``, and nothing else is paid. The environment
parameter ``rooms`` is the difficulty: chance gets through few of them, but each is furnished anew, which nobody can
foresee, and that is what curiosity is paid for.
"""

import sys

import numpy as np

from corridor_server.main import main
from corridor_server.protocol.agents import Agents, Behavior, Sensor
from corridor_server.simulations.simulation import Simulation

MOST_STEPS, SOLVED, SIZE, PILLARS = 400, 2.0, 9, 4
FREE, WALL, PILLAR, SWITCH, PRESSED, GOAL = range(-1, 5)
PLACE = Behavior("Rooms?team=0", (Sensor.of("rays and state", (172,)),), discrete_branches=(5,))
STEPS = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
REACH = np.arange(0.5, 1.5 * SIZE, 0.5)
ANGLES = (np.arange(24) / 12 + np.arange(4)[:, None] / 2) * np.pi  # rays all around, by where the agent looks
CROSSED = np.rint(np.stack([np.cos(ANGLES), np.sin(ANGLES)], -1)[:, :, None] * REACH[:, None]).astype(int)
BEHAVIORS = {PLACE.name: PLACE}


class SwitchedRooms(Simulation):
    behaviors = BEHAVIORS

    def __init__(self, seed: int, num_areas: int) -> None:
        self.rng = np.random.default_rng(seed % 2**32)
        self.ids, self.rooms = np.arange(num_areas), 3
        self.cells = np.full((num_areas, SIZE, SIZE), WALL)
        self.place = np.zeros((num_areas, 2), np.int64)
        self.heading, self.steps, self.room = np.zeros((3, num_areas), np.int64)
        self.bumped = np.zeros(num_areas, bool)

    def set_parameter(self, name, value):
        if name != "rooms":
            raise ValueError(f"{name} is none of this scene's parameters.")
        self.rooms = int(value)

    def reset(self):
        self.begin(self.ids)
        return {PLACE.name: self.asking(np.zeros(len(self.ids)))}

    def begin(self, areas):
        self.furnish(areas)
        self.heading[areas] = self.rng.integers(0, 4, len(areas))
        self.steps[areas] = self.room[areas] = self.bumped[areas] = 0

    def furnish(self, areas):
        self.cells[areas, 1:-1, 1:-1] = FREE
        for area in areas.tolist():
            places = self.rng.permutation(np.argwhere(self.cells[area] == FREE))[: PILLARS + 2]
            self.place[area] = places[0]
            self.cells[area, *places[1]] = SWITCH
            self.cells[area, *places[2:].T] = PILLAR

    def asking(self, rewards):
        return Agents.that_ask(self.ids, (self.observation(),), rewards)

    def observation(self):
        crossed = np.clip(self.place[:, None, None] + CROSSED[self.heading], 0, SIZE - 1)
        seen = self.cells[self.ids[:, None, None], crossed[..., 0], crossed[..., 1]]
        first = (seen != FREE).argmax(-1)
        kinds = np.take_along_axis(seen, first[..., None], -1)[..., 0]
        rays = np.concatenate([np.eye(6)[kinds], (first / len(REACH))[..., None]], -1).reshape(len(kinds), -1)
        # What it just did is not among them: curiosity's features would then have to tell nothing else.
        times = self.room / self.rooms, self.steps / MOST_STEPS
        state = np.stack([self.bumped, self.room == self.rooms, *times], 1)
        return np.concatenate([rays, state], 1, dtype=np.float32)

    def step(self, actions):
        choice = actions[PLACE.name].discrete[:, 0]
        move, turn = (choice == 1) * 1 - (choice == 2), (choice == 3) * 1 - (choice == 4)
        self.heading, self.steps = (self.heading + turn) % 4, self.steps + 1
        there = self.place + move[:, None] * STEPS[self.heading]
        met = self.cells[self.ids, there[:, 0], there[:, 1]]
        self.bumped = (move != 0) & (met != FREE)
        self.place = np.where((met == FREE)[:, None], there, self.place)
        self.press(self.ids[(met == SWITCH)], there)
        solved = met == GOAL
        over = solved | (self.steps >= MOST_STEPS)
        rewards = SOLVED * solved - 1 / MOST_STEPS
        ended = Agents.that_ended(self.ids[over], (self.observation()[over],), rewards[over], ~solved[over])
        numbers = {"Rooms/Solved": solved[over] * 1.0, "Rooms/Switches": self.room[over] * 1.0}
        self.begin(self.ids[over])
        return {PLACE.name: ended.then(self.asking(np.where(over, 0, rewards)))}, numbers

    def press(self, areas, there):
        self.room[areas] += 1
        last = self.room[areas] == self.rooms
        self.furnish(areas[~last])
        for area in areas[last].tolist():
            self.cells[area, *there[area]] = PRESSED
            free = [place for place in np.argwhere(self.cells[area] == FREE) if (place != self.place[area]).any()]
            self.cells[area, *self.rng.choice(free)] = GOAL


if __name__ == "__main__":
    sys.exit(main(make_simulation=SwitchedRooms))

"""What each of the stand-in's scenes is there for: who asks when, who comes and goes, what they see and may do."""

import io
import random

import numpy as np
import pytest
from PIL import Image
from playing import always, at_random, ledger, playing


def seen(info, sensor: int = 0) -> list[float]:
    return list(info.observations[sensor].float_data.data)


class TestWhoAsks:
    def test_everybody_asks_at_their_own_period_and_offset(self, tmp_path):
        with playing("uneven", tmp_path) as game:
            for step in range(60):  # the first agent asks in every fixed step, so there is a message in each
                expected = [place for place, (period, offset) in enumerate(UNEVEN) if step % period == offset]
                assert [info.id for info in game.asking()] == expected
                game.step(always(0.01))

    def test_two_agents_take_turns(self, tmp_path):
        with playing("single_turns", tmp_path) as game:
            order = []
            for _ in range(30):
                order.append([info.id for info in game.asking()])
                game.step(always(0.0))
            assert order == [[1], [0]] * 15

    def test_a_late_behavior_is_announced_with_its_first_agent(self, tmp_path):
        with playing("late_behavior", tmp_path) as game:
            announced = []
            for number in range(30):
                brains = game.output.rl_initialization_output.brain_parameters
                announced += [(number, brain.brain_name) for brain in brains]
                assert bool(game.infos("Late")) == (number >= 10)
                game.step(always(0.01))
            assert announced == [(0, "Early?team=0"), (10, "Late?team=0")]
            assert [info.id for info in game.infos("Late")] == [1]

    def test_two_behaviors_do_not_always_ask_together(self, tmp_path):
        with playing("two_behaviors", tmp_path) as game:
            together = set()
            for _ in range(30):
                game.step(at_random(random.Random(len(game.messages))))
                together.add((bool(game.infos("Walker")), bool(game.infos("Chooser"))))
            assert together == {(True, True), (True, False), (False, True)}

    def test_teams_are_behaviors(self, tmp_path):
        with playing("teams", tmp_path) as game:
            assert {name: [info.id for info in listed.value] for name, listed in agent_infos(game)} == {
                "Soccer?team=0": [0, 1],
                "Soccer?team=1": [2, 3],
            }


UNEVEN = ((1, 0), (2, 1), (3, 2), (5, 3))  # periods and offsets


def of_group(number: int, infos: list) -> list:
    return [info for info in infos if info.group_id == number]


def agent_infos(game):
    return game.output.rl_output.agentInfos.items()


class TestWhoComesAndGoes:
    def test_one_that_is_disabled_ends_and_comes_again_with_a_new_id(self, tmp_path):
        with playing("agents_come_and_go", tmp_path) as game:
            gone, highest = set(), -1
            for _ in range(80):
                game.step(always(0.0))
                for info in game.infos():
                    assert info.id not in gone
                    assert info.id <= highest + 1 or highest == -1
                    highest = max(highest, info.id)
                    if info.done and info.id != 0:
                        assert not info.max_step_reached
                        gone.add(info.id)
            assert len(gone) > 10

    def test_one_may_end_before_it_ever_decided(self, tmp_path):
        with playing("ends_before_deciding", tmp_path) as game:
            for _ in range(40):
                game.step(always(0.0))
            undecided = [books for books in game.books.values() if not books.decisions]
            assert len(undecided) > 3
            assert all(books.ends == ["terminated"] for books in undecided)

    def test_a_group_is_paid_together_and_ends_together(self, tmp_path):
        dead, ends = [], set()
        with playing("groups", tmp_path) as game:
            for _ in range(150):
                game.step(at_random(random.Random(len(game.messages))))
                for blue in (of_group(2, game.ended()), of_group(2, game.asking())):
                    if not blue:
                        continue
                    assert [info.id for info in blue] == [3, 4]
                    arrived = blue[0].done and not blue[0].max_step_reached
                    earned = (blue[0].reward + blue[1].reward) / 2
                    assert all(info.group_reward == pytest.approx(earned / 2 + arrived, abs=1e-5) for info in blue)
                    assert len({(info.done, info.max_step_reached) for info in blue}) == 1
                    ends.add((blue[0].done, blue[0].max_step_reached))
                red = of_group(1, game.ended())
                dead += red if len(red) == 1 else []
            assert {(False, False), (True, True)} <= ends
            assert dead  # before its group's end, alone, and with the group's id
            assert not any(info.max_step_reached or info.id in (0, 1) for info in dead)


class TestWhatTheyMayDo:
    def test_masks_say_what_is_forbidden_and_are_not_enforced(self, tmp_path):
        broken = 0
        with playing("discrete_masks", tmp_path) as game:
            assert list(game.specs["GridWorld?team=0"].action_spec.discrete_branch_sizes) == [5, 3]
            for _ in range(80):
                for info in game.asking():
                    left, right = seen(info)[0] < -0.5, seen(info)[0] > 0.5
                    mask = list(info.action_mask)
                    assert len(mask) == 8
                    assert (mask[:4], mask[5:]) == ([False, left, right, False], [False, left, right])
                    broken += 2 * left
                game.step(always(0.0, 1))  # left in both branches
            assert game.quit() == 0
        assert broken
        lines = game.log.read_text().splitlines()
        assert sum(int(line.split('"forbidden": ')[1].split(",")[0]) for line in lines if "forbidden" in line) == broken

    def test_hybrid_actions_act_both(self, tmp_path):
        with playing("hybrid", tmp_path) as game:
            spec = game.specs["Hybrid?team=0"].action_spec
            assert (spec.num_continuous_actions, list(spec.discrete_branch_sizes)) == (2, [3, 4])
            before = {info.id: seen(info) for info in game.asking()}
            game.step(always(0.5, 2))  # of four parts, two are 0.5 and two are 1, for three steps
            for info in game.asking():
                moved = min(1.0, before[info.id][0] + 3 * 0.075)
                assert seen(info)[0] == pytest.approx(moved, abs=1e-5)


class TestWhatTheySee:
    def test_a_vector_a_goal_and_a_padded_buffer(self, tmp_path):
        filled = set()
        with playing("buffers_and_goal", tmp_path) as game:
            for _ in range(60):
                for info in game.infos():
                    vector, goal, buffer = info.observations
                    assert (list(vector.shape), list(vector.dimension_properties)) == ([2], [1])
                    assert (list(goal.shape), goal.observation_type, goal.name) == ([4], 1, "goal")
                    assert sum(seen(info, 1)) == 1
                    assert seen(info, 1)[min(int((seen(info)[1] + 1) * 2), 3)] == 1
                    assert (list(buffer.shape), list(buffer.dimension_properties)) == ([4, 3], [4, 1])
                    rows = np.reshape(seen(info, 2), (4, 3))
                    there = int((rows != 0).any(axis=1).sum())
                    assert not rows[there:].any()
                    filled.add(there)
                game.step(always(0.05))
        assert filled == {0, 1, 2, 3, 4}

    def test_pictures_are_channels_first(self, tmp_path):
        with playing("pictures", tmp_path) as game:
            for _ in range(20):
                for info in game.infos():
                    _, grey, colour, grid, raw = info.observations
                    columns = [round((place + 1) / 2 * 9) for place in seen(info)[:2]]  # of the agent and its target
                    assert [list(each.shape) for each in info.observations[1:]] == [[c, 6, 10] for c in (1, 3, 5, 2)]
                    assert all(list(each.dimension_properties) == [1, 2, 2] for each in info.observations[1:])
                    mappings = [list(each.compressed_channel_mapping) for each in (grey, colour, grid, raw)]
                    assert mappings == [[0, 0, 0], [], [0, 1, 2, 3, 4, -1], []]
                    decoded = [decode(each.compressed_data) for each in (grey, colour, grid)]
                    decoded.append(np.reshape(raw.float_data.data, (2, 6, 10)) * 255)
                    assert [len(each) for each in decoded] == [3, 3, 6, 2]
                    for picture, last in zip(decoded, (0, 2, 4, 1), strict=True):
                        if last:
                            assert picture[0].nonzero()[1].tolist() == [columns[0]] * 6
                        assert picture[last].nonzero()[1].tolist().count(columns[1]) == 6
                game.step(always(0.5))

    def test_vectors_share_what_there_is(self, tmp_path):
        with playing("pyramids_like", tmp_path) as game:
            (info,) = game.infos()
            assert [list(each.shape) for each in info.observations] == [[14], [14], [4]]
            place, target, way = seen(info)[:3]
            assert way == pytest.approx(target - place, abs=1e-6)
            assert seen(info, 1)[:3] == [way, place, target]


def decode(data: bytes) -> np.ndarray:
    """(C, 6, 10) of PNGs that stand one after another."""
    parts = data.split(b"\x89PNG\r\n\x1a\n")[1:]
    images = [np.asarray(Image.open(io.BytesIO(b"\x89PNG\r\n\x1a\n" + part))) for part in parts]
    return np.concatenate(images, axis=2).transpose(2, 0, 1)


def test_areas_are_alike_and_groups_are_each_areas_own(tmp_path):
    with playing("two_behaviors", tmp_path, num_areas=3) as game:
        for _ in range(10):
            game.step(always(0.0))
        assert game.quit() == 0
    assert sorted(ledger(game.log)[1]) == list(range(9))

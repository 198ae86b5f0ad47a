"""The stand-in for Unity's runtime says what Unity says, message by message."""

import ast
import random
import re
import struct
import subprocess
import sys
import time

import pytest
from conftest import unused_port
from playing import BUILD, SPECS, always, at_random, ledger, parameter, playing, started

from corridor_server.protocol import side_channels as channels
from corridor_server.protocol.messages import UnityMessageProto
from corridor_server.protocol.trainer_messages import initialization, quitting, stopping

ALONE = ("--alone", "1")  # seconds that it plays by itself


def x(info) -> float:
    return info.observations[0].float_data.data[0]


def target(info) -> float:
    return info.observations[0].float_data.data[1]


def statistics(output) -> list[str]:
    split = channels.split(output.rl_output.side_channel)
    return [data[4 : 4 + data[0]].decode() for channel, data in split if channel == channels.STATISTICS]


def test_it_shares_no_code_with_the_package():
    sources = [BUILD, *BUILD.with_name("standin").glob("*.py")]
    nodes = [node for path in sources for node in ast.walk(ast.parse(path.read_text()))]
    imported = {each.name for node in nodes if isinstance(node, ast.Import) for each in node.names}
    imported |= {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    tops = {name.split(".")[0] for name in imported}
    assert tops - set(sys.stdlib_module_names) == {"grpc", "standin"}


@pytest.mark.parametrize("spec", SPECS)
def test_its_ledger_is_what_was_received_and_its_bytes_are_proto3s(spec, tmp_path):
    """Every field in order, none that is false, 0 or empty, numbers as short as they can be: as C# writes them."""
    generator = random.Random(0)
    with playing(spec, tmp_path, num_areas=2) as game:
        for number in range(150):
            game.reset() if number in (50, 51) else game.step(at_random(generator))
        assert game.quit() == 0
    for message in game.messages:
        parsed = UnityMessageProto.FromString(message)
        if len(parsed.unity_output.rl_output.agentInfos) == 1:  # a map's entries have no order
            assert parsed.SerializeToString() == message
    life, sent = ledger(game.log)
    assert life["end"] == "QUIT"
    assert life["messages"] == len(game.messages)
    received = {number: books.rounded() for number, books in sorted(game.books.items())}
    assert received == {number: books.rounded() for number, books in sorted(sent.items())}


class TestHandshake:
    def test_it_names_itself_and_declares_every_capability(self, tmp_path):
        with started("no_replicator", tmp_path) as game:
            first = game.trainer.receive()
            assert first.header.status == 200
            hello = first.unity_output.rl_initialization_output
            assert hello.name == "AcademySingleton"
            assert (hello.communication_version, hello.package_version) == ("1.5.0", "3.0.0")
            assert all(getattr(hello.capabilities, name) for name in hello.capabilities.DESCRIPTOR.fields_by_name)
            game.trainer.reply(initialization())
            assert game.trainer.receive_bytes() == b"\x0a\x03\x08\xc8\x01"  # a header with status 200, nothing else

    @pytest.mark.parametrize("refusal", ["major version", "status", "status after the acknowledgement", "QUIT", "cut"])
    def test_what_ends_a_game_leaves_it_alone_in_the_handshake(self, refusal, tmp_path):
        with started("no_replicator", tmp_path, *ALONE) as game:
            game.trainer.receive()
            if refusal == "major version":
                game.trainer.reply(initialization(version="2.0.0"))
            elif refusal == "status":
                game.trainer.reply(stopping())
            else:
                game.trainer.ask(initialization())
                if refusal == "cut":
                    game.trainer.cut()
                else:
                    game.trainer.reply(quitting() if refusal == "QUIT" else stopping())
            began = time.monotonic()
            assert game.process.wait(10) == 0
            assert time.monotonic() - began > 0.8
            assert "plays by itself" in game.log.read_text()

    def test_another_minor_version_is_taken(self, tmp_path):
        with started("no_replicator", tmp_path) as game:
            game.trainer.handshake(version="1.9.0")
            game.reset()
            assert len(game.asking()) == 1

    def test_it_dials_once(self, tmp_path):
        command = [sys.executable, BUILD, "--mlagents-port", str(unused_port()), *ALONE]
        done = subprocess.run(command, capture_output=True, text=True, timeout=20)
        assert done.returncode == 0
        assert "plays by itself" in done.stderr

    @pytest.mark.parametrize(("hybrid", "old"), [(True, ([], 0)), (False, ([2], 1))])
    def test_old_trainers_alone_get_the_deprecated_fields(self, hybrid, old, tmp_path):
        with started("no_replicator", tmp_path) as game:
            game.trainer.receive()
            start = initialization()
            start.unity_input.rl_initialization_input.capabilities.hybridActions = hybrid
            game.trainer.ask(start)
            game.reset()
            brain = game.specs["Corridor?team=0"]
            assert (list(brain.vector_action_size_deprecated), brain.vector_action_space_type_deprecated) == old
            assert brain.action_spec.num_continuous_actions == 2
            assert brain.is_training

    @pytest.mark.parametrize(("spec", "count"), [("corridor_like", 5), ("no_replicator", 1)])
    def test_only_a_replicator_heeds_num_areas(self, spec, count, tmp_path):
        with playing(spec, tmp_path, num_areas=5) as game:
            assert [info.id for info in game.infos()] == list(range(count))


class TestEnd:
    def test_status_400_and_a_broken_channel_have_code_0(self, tmp_path):
        with playing("uneven", tmp_path) as game:
            game.trainer.reply(stopping())
            assert game.process.wait(10) == 0
        with playing("uneven", tmp_path) as game:
            game.trainer.cut()
            assert game.process.wait(10) == 0
            assert "the connection broke" in game.log.read_text()

    def test_one_that_stops_by_itself_says_so_and_may_linger(self, tmp_path):
        scene = tmp_path / "short.toml"
        scene.write_text('announces_end = 3\nlingers = 2\n[[behaviors]]\nname = "Short"\ncontinuous = 1\n')
        with playing(scene, tmp_path) as game:
            game.step()
            game.step()
            game.trainer.reply(initialization())
            assert game.trainer.receive().header.status == 400
            game.trainer.reply(stopping())
            time.sleep(0.5)
            assert game.process.poll() is None
            assert game.process.wait(10) == 0
        with playing("uneven", tmp_path) as game:
            game.process.terminate()
            assert game.trainer.receive().header.status == 400


class TestEpisodes:
    def test_ids_are_for_life_and_ends_come_alone(self, tmp_path):
        """With a period of five, a message with ended agents has nobody who asks; they ask again with the same id."""
        with playing("corridor_like", tmp_path, num_areas=3) as game:
            ends = 0
            for number in range(500):
                if number in (100, 101):
                    game.reset()
                    assert not game.ended()
                else:
                    game.step(always(-1.0))
                ids = [info.id for info in game.infos()]
                assert ids == ([0, 1, 2] if not game.ended() else sorted(set(ids)))
                assert not (game.ended() and game.asking())
                ends += len(game.ended())
            assert ends > 3

    def test_with_a_period_of_one_ends_and_next_requests_come_together_ended_ones_first(self, tmp_path):
        with playing("discrete_masks", tmp_path) as game:
            for _ in range(59):
                game.step(always(0.0, 0))
            game.step(always(0.0, 0))
            assert [(info.id, info.done) for info in game.infos()] == [(0, True), (1, True), (0, False), (1, False)]
            assert all(info.max_step_reached for info in game.ended())

    def test_every_end_says_whether_it_was_a_step_limit(self, tmp_path):
        with playing("pyramids_like", tmp_path, num_areas=4) as game:
            kinds = set()
            for _ in range(400):
                game.step(at_random(random.Random(len(game.messages))))
                for info in game.ended():
                    assert info.max_step_reached == (abs(target(info) - x(info)) > 0.05)
                    kinds.add(info.max_step_reached)
            assert kinds == {True, False}

    def test_a_reset_drops_requests_ends_nothing_and_acts_once_with_zeros(self, tmp_path):
        with playing("corridor_like", tmp_path, num_areas=2) as game:
            assert [info.reward for info in game.infos()] == [0.0, 0.0]  # the first RESET comes before any step
            for _ in range(3):
                game.step(always(1.0))
            game.reset()
            assert [info.id for info in game.asking()] == [0, 1]
            assert not game.ended()
            for info in game.asking():
                assert info.reward == pytest.approx(-0.001)  # of the step with a zero action
                assert list(info.observations[0].float_data.data[2:4]) == [0.0, 0.0]  # it is at rest

    def test_rewards_follow_from_actions(self, tmp_path):
        """Everybody repeats an action until the next request; the reward is how much nearer they came, and 1."""
        generator = random.Random(1)
        actions, last, judged = {}, {}, set()

        def choose(info, _):
            actions[info.id] = generator.uniform(-1, 1)
            return [actions[info.id]], []

        with playing("uneven", tmp_path) as game:
            for _ in range(300):
                last |= {info.id: info for info in game.asking()}
                game.step(choose)
                for info in game.infos():
                    before = last.get(info.id)
                    if before is None or target(before) != target(info):
                        continue  # a new episode
                    nearer = abs(target(info) - x(before)) - abs(target(info) - x(info))
                    arrived = info.done and not info.max_step_reached
                    assert info.reward == pytest.approx(nearer + arrived, abs=1e-5)
                    if not info.done:
                        period = (1, 2, 3, 5)[info.id]
                        moved = max(-1.0, min(1.0, x(before) + 0.1 * actions[info.id] * period))
                        assert x(info) == pytest.approx(moved, abs=1e-5)
                    judged.add((info.id, info.done))
        assert judged == {(number, done) for number in range(4) for done in (False, True)}

    def test_no_actions_are_zeros(self, tmp_path):
        with playing("uneven", tmp_path) as game:
            places = {info.id: x(info) for info in game.infos()}
            game.step()
            assert [x(info) for info in game.infos() if info.id == 0] == [places[0]]

    def test_statistics_come_with_ends_or_not_at_step_limits(self, tmp_path):
        with playing("step_limit_without_statistics", tmp_path, num_areas=4) as game:
            terminated = interrupted = 0
            for _ in range(400):
                game.step(lambda info, _: ([-1.0 if info.id % 2 else 0.0, 0.0], []))  # every other one runs into a wall
                full = [info for info in game.ended() if not info.max_step_reached]
                terminated += len(full)
                interrupted += len(game.ended()) - len(full)
                assert statistics(game.output).count("Corridor/Success") == len(full)
            assert terminated
            assert interrupted


class TestSideChannels:
    def test_a_value_is_read_when_an_episode_begins(self, tmp_path):
        with playing("discrete_masks", tmp_path) as game:
            game.step(side_channel=parameter("target", "<if", 0, 0.25))
            game.reset()
            assert [target(info) for info in game.infos()] == [0.25, 0.25]

    @pytest.mark.parametrize(
        "sampler",
        [("<3i2f", 1, 7, 0, 0.5, 0.75), ("<3i2f", 1, 7, 1, 0.625, 0.01), ("<4i4f", 1, 7, 2, 4, 0.5, 0.6, 0.7, 0.75)],
    )
    def test_a_sampler_draws_at_every_reading_and_has_one_stream(self, sampler, tmp_path):
        drawn = []
        for _ in range(2):
            with playing("discrete_masks", tmp_path) as game:
                game.step(side_channel=parameter("target", *sampler))
                targets = []
                for _ in range(10):
                    game.reset()
                    targets += [target(info) for info in game.infos()]
            assert len(set(targets)) == 20
            assert all(0.5 <= each <= 0.75 for each in targets)
            drawn.append(targets)
        assert drawn[0] == drawn[1]

    def test_engine_settings_are_told_to_the_log_and_time_scales_below_1_are_1(self, tmp_path):
        with playing("uneven", tmp_path) as game:
            for scale in (20.0, 0.5):
                settings = channels.message(channels.ENGINE_CONFIGURATION, struct.pack("<if", 2, scale))
                game.step(side_channel=settings)
            assert re.findall("time scale (.*)", game.log.read_text()) == ["20", "1"]

    def test_bytes_that_are_cut_are_an_exception_in_the_log_and_it_goes_on(self, tmp_path):
        with playing("uneven", tmp_path) as game:
            game.step(side_channel=parameter("target", "<if", 0, 0.5)[:-3])
            assert "exception: channel 534c891e" in game.log.read_text()
            assert game.step()

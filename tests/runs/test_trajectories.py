"""What an evaluation records, and what the page is given of it: the same numbers, bit for bit."""

import base64
import dataclasses
import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from asked import asked
from conftest import corridor_here
from recorded_run import GOLDEN, recorded_run, settings

from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.gym_env import CorridorEnv
from trainer.corridor import corridor_of
from trainer.errors import TrainerError
from trainer.runs.evaluation import Episode
from trainer.runs.folder import RunFolder
from trainer.runs.trajectories import Trajectories, load_trajectories, save_trajectories
from trainer.viewer.corridor_scene import FOREIGN, begin_again, choose, episode_record, run_scene

CONFIG = settings()


def table(record: dict) -> dict[str, np.ndarray]:
    """The page's table, unpacked as ``unpack`` in ``data.ts`` does it."""
    shuffled = np.frombuffer(zlib.decompress(base64.b64decode(record["data"])), np.uint8)
    values = shuffled.reshape(4, -1).T.copy().view("<f4").reshape(len(record["columns"]), record["length"] + 1)
    return dict(zip(record["columns"], values, strict=True))


def some_episode(seed: int, length: int = 30, **changes: object) -> Episode:
    rng = np.random.default_rng(seed)
    values = {
        "observations": rng.normal(size=(length + 1, 13)).astype(np.float32),
        "actions": rng.uniform(-1, 1, (length, 2)).astype(np.float32),
        "rewards": rng.normal(size=length).astype(np.float32),
        "truncated": False,
        "slot": seed,
        "statistics": {"Corridor/Success": float(seed % 2)},
    }
    return Episode(**{**values, **changes})  # type: ignore[arg-type]


def same(one: Episode, other: Episode) -> bool:
    return all(
        np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in dataclasses.fields(Episode)
    )


def refusal(path: Path) -> str | None:
    try:
        load_trajectories(path)
    except TrainerError as error:
        return str(error)
    return None


def test_a_file_gives_back_every_number(tmp_path):
    episodes = [some_episode(0), some_episode(1, truncated=True), some_episode(2, statistics={}, length=1)]
    for seed in (7, None):
        save_trajectories(tmp_path / "t.npz", Trajectories("Corridor?team=0", seed, 500, episodes))
        read = load_trajectories(tmp_path / "t.npz")
        assert (read.behavior, read.seed, read.env_steps) == ("Corridor?team=0", seed, 500)
        assert [same(one, other) for one, other in zip(read.episodes, episodes, strict=True)] == [True] * 3
    assert not (tmp_path / "t.npz.tmp").exists()


def test_what_networks_made_of_an_episode_is_kept_and_older_files_have_none(tmp_path):
    rng = np.random.default_rng(0)
    plain = [some_episode(0), some_episode(1, length=4)]
    full = [
        dataclasses.replace(
            episode,
            values=rng.normal(size=len(episode.observations)).astype(np.float32),
            intrinsic_rewards=rng.exponential(0.01, len(episode.rewards)).astype(np.float32),
        )
        for episode in plain
    ]
    path = tmp_path / "t.npz"
    for episodes in (full, plain, [dataclasses.replace(each, intrinsic_rewards=None) for each in full]):
        save_trajectories(path, Trajectories("Corridor?team=0", 1, 9, episodes))
        assert all(map(same, load_trajectories(path).episodes, episodes))
    assert {"values", "intrinsic_rewards"}.isdisjoint(np.load(GOLDEN / "trajectories.npz").files)
    save_trajectories(path, Trajectories("Corridor?team=0", 1, 9, full))
    np.savez(path, **{**np.load(path), "values": np.zeros(7, np.float32)})
    assert "different lengths" in str(refusal(path))

    columns = table(episode_record(full[0], 0, CorridorConfig(), None))
    assert np.allclose(columns["value"], full[0].values, rtol=2**-12)
    assert np.allclose(columns["intrinsic"], [0, *full[0].intrinsic_rewards], rtol=2**-12)
    assert {"value", "intrinsic"}.isdisjoint(table(episode_record(plain[0], 0, CorridorConfig(), None)))


def test_a_broken_file_is_one_sentence(tmp_path):
    whole = (GOLDEN / "trajectories.npz").read_bytes()
    expected = load_trajectories(GOLDEN / "trajectories.npz").episodes
    path = tmp_path / "t.npz"
    refused = 0
    rng = np.random.default_rng(0)
    broken = [whole[:end] for end in (0, 1, 100, len(whole) // 2, len(whole) - 1)]
    for place in rng.integers(len(whole), size=100):
        flipped = bytearray(whole)
        flipped[place] ^= 0xFF
        broken.append(bytes(flipped))
    for data in broken:
        path.write_bytes(data)
        sentence = refusal(path)
        if sentence is None:  # the byte carries nothing, as one of a date
            assert all(map(same, load_trajectories(path).episodes, expected))
            continue
        refused += 1
        assert str(path) in sentence
        assert "corridor evaluate" in sentence
    assert refused > 90


def test_a_file_with_code_in_it_is_refused(tmp_path):
    np.savez(tmp_path / "t.npz", version=np.array([object()]))
    with pytest.raises(TrainerError, match="broken"):
        load_trajectories(tmp_path / "t.npz")


def test_an_evaluation_records_what_the_in_process_world_says(tmp_path):
    recorded = load_trajectories(GOLDEN / "trajectories.npz")
    world = dataclasses.asdict(corridor_of(CONFIG.penalty, CONFIG.environment_parameters))
    for episode in recorded.episodes:
        env = CorridorEnv(area=episode.slot, **world)
        observation, _ = env.reset(seed=recorded.seed)
        assert np.array_equal(observation, episode.observations[0])
        for t, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            assert np.array_equal(observation, episode.observations[t + 1])
            assert np.float32(reward) == episode.rewards[t]
            assert terminated == (t + 1 == len(episode.rewards))
            assert not truncated
        assert info["is_success"] == episode.succeeded
        assert {name: np.float32(value) for name, value in info["statistics"].items()} == {
            name: np.float32(value) for name, value in episode.statistics.items()
        }


def test_the_page_has_the_recorded_numbers_and_what_is_hidden():
    recorded = load_trajectories(GOLDEN / "trajectories.npz")
    scene = run_scene(CONFIG, recorded)
    assert scene["notes"] == []
    assert len(scene["episodes"]) == 12
    for record in scene["episodes"]:
        episode = recorded.episodes[record["number"]]
        columns = table(record)
        for index, name in enumerate(("p_x", "p_z")):
            assert np.array_equal(columns[name], episode.observations[:, index])
        assert np.array_equal(columns["switch"], episode.observations[:, 7])
        for index, name in ((8, "op0_x"), (9, "op0_z"), (10, "op0_d")):
            assert np.array_equal(columns[name], episode.observations[:, index])
        assert np.array_equal(columns["reward"][1:], episode.rewards)
        assert np.array_equal(np.stack([columns["a_x"], columns["a_z"]], axis=1)[1:], episode.actions)
        assert record["outcome"] == ("goal" if episode.succeeded else "failed")
        assert record["return"] == episode.rewards.sum(dtype=np.float64)
        target = np.array(record["opponent_targets"][0])
        # The opponent goes straight to it: it lies ahead on the opponent's line, at the x that it always has.
        start = episode.observations[0, 8:10] * 10
        heading = episode.observations[0, 11:13]
        assert target[0] == corridor_of(CONFIG.penalty, CONFIG.environment_parameters).opponent_target_x
        across = (target - start) / np.linalg.norm(target - start)
        assert np.allclose(across, heading / np.linalg.norm(heading), atol=1e-5)


def test_a_run_through_the_gym_wrapper_is_shown_as_our_player_s(tmp_path, free_port):
    options = ("--steps", 128, "--eval-episodes", 2, "--results-dir", tmp_path, "--base-port", free_port)
    done = corridor_here("train", "--run-id", "gym", "--preset", "paper", *options)
    assert done.returncode == 0, done.stderr
    folder = RunFolder(tmp_path / "gym")
    recorded = load_trajectories(folder.trajectories)
    assert run_scene(folder.read_config(), recorded)["notes"] == []
    for number, episode in enumerate(recorded.episodes):
        assert np.array_equal(begin_again(folder.read_config(), recorded, number)[1], episode.observations[0])


@pytest.mark.parametrize("what", ["observations", "rewards"])
def test_another_world_than_ours_keeps_its_secrets(what):
    recorded = load_trajectories(GOLDEN / "trajectories.npz")
    other = getattr(recorded.episodes[3], what).copy()
    other[7] = np.nextafter(other[7], np.float32(2))
    recorded.episodes[3] = dataclasses.replace(recorded.episodes[3], **{what: other})
    scene = run_scene(CONFIG, recorded)
    assert scene["notes"] == [FOREIGN]
    assert scene["corridor"]["switch"] is None
    assert all(record["opponent_targets"] is None for record in scene["episodes"])


def test_a_foreign_player_without_statistics_is_shown_as_it_is():
    episodes = [some_episode(seed, statistics={}) for seed in range(3)]
    scene = run_scene(CONFIG, Trajectories("Corridor?team=0", None, 9, episodes))
    assert scene["notes"] == [FOREIGN]
    assert [record["outcome"] for record in scene["episodes"]] == ["ended"] * 3


def test_another_behavior_cant_be_shown():
    with pytest.raises(TrainerError, match="Walker"):
        run_scene(CONFIG, Trajectories("Walker?team=0", None, 9, [some_episode(0)]))


def test_failures_closest_calls_and_successes_share_the_places():
    near = np.ones((31, 13), np.float32)
    near[5, 10] = 0.05
    episodes = [some_episode(0, statistics={"Corridor/Success": float(row % 10 != 0)}) for row in range(200)]
    episodes[155] = dataclasses.replace(episodes[155], observations=near)
    far = np.full((31, 13), 2.0, np.float32)
    episodes = [e if row == 155 else dataclasses.replace(e, observations=far) for row, e in enumerate(episodes)]
    chosen = choose(episodes, 20)
    assert len(set(chosen)) == 20
    assert chosen == sorted(chosen)
    assert sum(row % 10 == 0 for row in chosen) == 6
    assert 155 in chosen
    assert choose(episodes[:3], 20) == [0, 1, 2]
    assert len(choose(episodes[::10], 12)) == 12  # failures alone fill the places, too


def test_the_record_is_json_of_a_few_kilobytes():
    record = episode_record(some_episode(0, length=1000), 0, CorridorConfig(), None)
    assert len(json.dumps(record)) < 60_000


def test_the_recorded_run_is_found_by_its_folder(tmp_path):
    assert len(load_trajectories(recorded_run(tmp_path).trajectories).episodes) == 12
    with pytest.raises(TrainerError, match="corridor evaluate"):
        load_trajectories(Path(tmp_path / "none.npz"))


def test_a_runs_corridor_is_what_its_player_was_told():
    """As float32, which the side channel carries; a range's own name sets both of its ends."""
    config = asked(
        "r", env_param=("switch_radius=0.1", "agent_spawn_x=-8", "opponent_spawn_x_min=6"), penalty=0.5
    ).run_config()
    told = corridor_of(config.penalty, config.environment_parameters)
    assert told.switch_radius == float(np.float32(0.1))
    assert told.agent_spawn_x == (-8.0, -8.0)
    assert told.opponent_spawn_x == (6.0, CorridorConfig().opponent_spawn_x[1])
    assert (told.agent_speed, told.failure_penalty, told.near_distance) == (3.0, 0.5, CorridorConfig().near_distance)

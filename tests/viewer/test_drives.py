"""Driving through the page's server: the in-process world, a run's corridor, and an evaluation's episodes."""

import dataclasses
import shutil

import numpy as np
import pytest
from page_requests import ask
from recorded_run import GOLDEN, begun_run, recorded_run, settings

from corridor_server.corridor.gym_env import CorridorEnv
from trainer.runs.trajectories import load_trajectories
from trainer.viewer.drives import Drives
from trainer.viewer.page_server import BODY_LIMIT


def test_a_body_that_is_no_action_is_refused(page_server):
    session = ask(page_server, "/api/drive/new", {})[1]["session"]
    for body in ("", "[]", "{", "[" * 2000, '{"a": "' + "x" * BODY_LIMIT + '"}'):
        assert ask(page_server, "/api/drive/step", body)[0] == 400
    for action in (None, [], [1], [1, 2, 3], ["a", "b"], [[1, 2], [3, 4]], [1e999, 0], "left", {"x": 1}):
        status, answer = ask(page_server, "/api/drive/step", {"session": session, "action": action})
        assert status == 400, action
        assert "expected" in answer["error"]
    assert ask(page_server, "/api/drive/step", {"session": "x", "action": [0, 0]})[0] == 400
    assert ask(page_server, "/api/drive/step", {"session": session, "action": [0, 0]})[0] == 200


def test_driving_is_the_in_process_world(page_server):
    begun = ask(page_server, "/api/drive/new", {})[1]
    env = CorridorEnv()
    observation, _ = env.reset(seed=int(np.random.default_rng(0).integers(2**31)))
    rng = np.random.default_rng(5)
    row, total, steps = begun["row"], 0.0, 0
    assert begun["opponent_targets"] == env.state.opponent_target[0].tolist()
    while row["outcome"] is None:
        values = row["values"]
        assert [values["p_x"], values["p_z"], values["switch"]] == observation[[0, 1, 7]].astype(float).tolist()
        assert [values["op0_x"], values["op0_z"], values["op0_d"]] == observation[8:11].astype(float).tolist()
        action = rng.uniform(-1.5, 1.5, 2).astype(np.float32)
        row = ask(page_server, "/api/drive/step", {"session": begun["session"], "action": action.tolist()})[1]
        observation, reward, terminated, _, _ = env.step(np.clip(action, -1, 1))
        assert row["values"]["reward"] == reward
        assert (row["outcome"] is not None) == terminated
        total, steps = total + reward, steps + 1
    assert row["outcome"] == "failed"
    assert total <= -2 + 1e-6
    status, answer = ask(page_server, "/api/drive/step", {"session": begun["session"], "action": [0, 0]})
    assert (status, answer["error"]) == (400, "This drive is over; begin a new episode.")


def test_a_runs_corridor_and_its_evaluations_episodes_can_be_driven(page_server, tmp_path):
    recorded_run(tmp_path / "results")
    for number, episode in enumerate(load_trajectories(GOLDEN / "trajectories.npz").episodes):
        begun = ask(page_server, "/api/drive/new", {"run": "fast", "episode": number})[1]
        row = begun["row"]
        assert begun["goal"] == pytest.approx(10 * episode.observations[0, 4:6], abs=1e-5)
        assert row["values"]["op0_z"] == episode.observations[0, 9]
        for action, reward in zip(episode.actions, episode.rewards, strict=True):
            row = ask(page_server, "/api/drive/step", {"session": begun["session"], "action": action.tolist()})[1]
            assert row["values"]["reward"] == reward
        assert row["outcome"] == ("goal" if episode.succeeded else "failed")
        if number == 1:
            break
    fast_one = dataclasses.replace(settings("fast-one"), environment_parameters={"agent_speed": 3.0, "goal_x": 5.0})
    begun_run(fast_one, tmp_path / "results")
    begun = ask(page_server, "/api/drive/new", {"run": "fast-one"})[1]
    again = ask(page_server, "/api/drive/new", {"run": "fast-one", "seed": begun["seed"]})[1]
    assert {**again, "session": ""} == {**begun, "session": ""}
    assert begun["goal"][0] == 5.0
    moved = ask(page_server, "/api/drive/step", {"session": begun["session"], "action": [0, 1]})[1]["values"]
    env = CorridorEnv(agent_speed=3.0, goal_x=5.0)
    env.reset(seed=0)
    assert moved["p_z"] - begun["row"]["values"]["p_z"] == pytest.approx(
        env.step(np.array([0, 1], np.float32))[0][1] - env.reset(seed=0)[0][1], abs=1e-5
    )


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({"run": "nobody"}, "The run 'nobody' is gone."),
        ({"run": "../results/fast"}, "is gone"),
        ({"run": ["fast"]}, "is gone"),
        ({"run": "fast", "episode": 12}, "There is no episode 12 of fast, whose evaluation has 12, from 0."),
        ({"run": "fast", "episode": -1}, "a whole number from 0"),
        ({"run": "fast", "episode": "x" * 999}, "a whole number from 0"),
        ({"run": "fast", "seed": -1}, "a whole number from 0"),
        ({"seed": "x"}, "a whole number from 0"),
        ({"run": "bare", "episode": 0}, "the run has not been evaluated"),
        ({"run": "moved", "episode": 0}, "Episode 0 of moved can't begin here as it was recorded"),
        ({"run": "walker"}, "only a corridor can be driven"),
    ],
)
def test_what_cant_be_driven_is_one_sentence(page_server, tmp_path, asked, sentence):
    results = tmp_path / "results"
    recorded_run(results)
    recorded_run(results, "bare", evaluated=False)
    moved = begun_run(dataclasses.replace(settings("moved"), environment_parameters={"goal_x": 5.0}), results)
    shutil.copy(GOLDEN / "trajectories.npz", moved.trajectories)
    walker = recorded_run(results, "walker")
    walker.configuration.write_text(walker.configuration.read_text() + "\nbehavior: {name: Walker}\n")
    status, answer = ask(page_server, "/api/drive/new", asked)
    assert status == 400
    assert sentence in answer["error"]
    assert answer["error"].count("\n") == 0


def test_any_episode_of_an_evaluation_is_given(page_server, tmp_path):
    recorded_run(tmp_path / "results")
    scene = ask(page_server, "/api/episode?run=fast&number=7")[1]["scene"]
    assert [record["number"] for record in scene["episodes"]] == [7]
    assert scene["episodes"] == [ask(page_server, "/api/scene?run=fast")[1]["scene"]["episodes"][7]]
    for query in ("run=fast&number=12", "run=fast&number=-1", "run=fast&number=x", "run=no&number=1", "run=fast", ""):
        assert ask(page_server, f"/api/episode?{query}")[0] == 400


def test_forgotten_drives_are_bounded(tmp_path):
    drives = Drives(tmp_path, 0)
    sessions = [drives.new()["session"] for _ in range(40)]
    with pytest.raises(ValueError, match="over"):
        drives.step(sessions[0], [0, 0])
    assert drives.step(sessions[-1], [0, 0])["outcome"] is None

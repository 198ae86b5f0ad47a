"""``corridor replay STUDY``: the report of a study's folder as ``corridor study`` leaves it."""

import json
from pathlib import Path

import pytest
from PIL import Image
from recorded_run import recorded_run

from trainer.errors import TrainerError
from trainer.main import main
from trainer.terminal import Terminal
from trainer.viewer.study_page import write_study_page

CLAIMS = [
    {"id": "C1", "statement": "Base PPO fails", "measure": "IQM < 0.05", "holds": True, "evidence": "0.00 [0, 0]"},
    {"id": "C2", "statement": "c = 0.3 works <b>", "measure": "IQM >= 0.9", "holds": False, "evidence": "0.85"},
]
EVALUATION = {"evaluation": {"success_rate": 0.83, "mean_return": 0.29, "mean_episode_length": 226.0}}


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "results" / "penalty"
    for place, run_id in ((folder, "c0-seed4"), (folder.parent / "other", "c0.3-seed4"), (folder, "c0.3-seed5")):
        run = recorded_run(place, run_id)
        run.write_summary(EVALUATION)
    (folder / "c0.3-seed5" / "trajectories.npz").unlink()
    arms = [{"name": "c0", "label": "base PPO"}, {"name": "c0.3", "label": "c = 0.3"}]
    record = {"study": "penalty", "claims": CLAIMS, "arms": arms, "seeds": 2, "first_seed": 4, "steps": 1_500_000}
    (folder / "claims.json").write_text(json.dumps({**record, "command": "corridor study penalty --seeds 2"}))
    Image.new("RGB", (60, 40), "white").save(folder / "figure6a.png")
    return folder


def test_a_studys_runs_are_one_click_from_their_replay(study, open_page):
    assert main(["replay", "penalty", "--results-dir", str(study.parent), "--episodes", "3"]) == 0
    opened = open_page((study / "report.html").as_uri())
    assert "corridor study penalty --seeds 2" in opened.inner_text("#subtitle")
    rows = opened.locator("#study tr").all_inner_texts()
    assert rows[1].split("\t") == ["C1", "Base PPO fails", "IQM < 0.05", "yes", "0.00 [0, 0]"]
    assert rows[2].split("\t") == ["C2", "c = 0.3 works <b>", "IQM >= 0.9", "no", "0.85"]
    assert opened.evaluate("document.querySelector('#study img').naturalWidth") == 60
    assert opened.inner_text("#notes") == "There is no evaluation of c0-seed5, c0.3-seed5, so no replay."
    assert "success 83%" in opened.inner_text("#study")
    for run_id in ("c0-seed4", "c0.3-seed4"):  # the second's folder is another study's
        opened.click(f"text={run_id}")
        opened.wait_for_selector("#episode-list li")
        assert opened.inner_text("#subtitle").startswith(run_id)
        assert opened.locator("#episode-list li").count() == 3
        opened.go_back()


def test_a_broken_study_is_one_sentence(study):
    (study / "claims.json").write_text('{"claims": []}')
    with pytest.raises(TrainerError, match="claims.json is broken"):
        write_study_page(study, 3, Terminal())

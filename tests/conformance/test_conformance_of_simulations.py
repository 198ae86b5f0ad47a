"""The protocol's level on environments of every kind that corridor-server plays, and on a player of one's own."""

import re
from pathlib import Path

import pytest
from conftest import BIN
from prepared import Prepared

from trainer.conformance import TOPICS, Actions, Episodes, Observations, Reset, VisualObservations
from trainer.conformance.checker import Result, check
from trainer.conformance.session import Session

# ``corridor check`` says the same of any other, whole; these are the quickest of their kinds.
OF_AN_ENVIRONMENT = [Observations, Episodes, Actions, Reset, VisualObservations]
KINDS = {
    "masks": ["--gym", "Taxi-v4"],
    "pictures": ["--gym", "minigrid:MiniGrid-DoorKey-6x6-v0", "--wrapper", "minigrid.wrappers:ImgObsWrapper"],
    "two behaviors, a group": ["--pettingzoo", "mpe2.simple_tag_v3", "--team", "agent=1", "--group", "adversary"],
    "turns": ["--pettingzoo", "pettingzoo.classic.tictactoe_v3"],
}
PAGE = Path(__file__).parents[2] / "docs" / "player.md"


def shorter_play(session: Session, messages: int, *seconds: float, play=Session.play):
    """A quarter of the messages, except where the kit itself stops at the first that it looks for."""
    return play(session, messages if messages > 1000 else messages // 4, *seconds)


def results(topics, *command):
    found: list[Result] = []
    check(topics, lambda port, *more: Prepared([*command, "--mlagents-port", port, *more]), found.append)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("options", KINDS.values(), ids=KINDS)
def test_what_corridor_server_plays_passes_the_protocols_level(options, tmp_path, monkeypatch):
    monkeypatch.setattr(Session, "play", shorter_play)
    found = results(OF_AN_ENVIRONMENT, BIN / "corridor-server", "-logFile", tmp_path / "log", *options)
    assert [each for each in found if each.verdict == "fail"] == []
    assert sum(each.verdict == "pass" for each in found) > 15


@pytest.mark.slow
def test_the_simulation_in_the_docs_passes_all_of_it_and_has_fifty_lines_at_most(tmp_path, monkeypatch):
    monkeypatch.setattr(Session, "play", shorter_play)
    [program] = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert program.count("\n") <= 50
    file = tmp_path / "hallway.py"
    file.write_text(program)
    found = results(TOPICS, file, "-logFile", tmp_path / "log")
    assert [each for each in found if each.verdict == "fail"] == []
    assert sum(each.verdict == "pass" for each in found) > 40

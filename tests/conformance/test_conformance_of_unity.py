"""The protocol's level is what Unity's runtime keeps: its stand-in passes all of it, whatever the scene."""

import json
from pathlib import Path

import pytest
from prepared import Prepared

from corridor_server.protocol.trainer_messages import quitting
from trainer.conformance import (
    TOPICS,
    BadPeers,
    Conformance,
    CorridorContract,
    Episodes,
    Reset,
    Shutdown,
    SideChannels,
)
from trainer.conformance.checker import Result, check
from trainer.conformance.session import Session

UNITY = Path(__file__).parents[1] / "unity"
SPECS = sorted(path.stem for path in (UNITY / "specs").glob("*.toml") if path.stem != "scene")  # needs a program
# What doesn't depend on the scene is checked on one of them, and what a scene is not there for on those that are;
# ``corridor check --env`` checks any scene whole.
WHOLE = "corridor_like"
OF_A_SCENE = [topic for topic in TOPICS if topic not in (SideChannels, Shutdown, BadPeers)]
ENDS_AND_RESETS = [Episodes, Reset]
MASKS = {"a mask has a mark for each choice of all branches", "a mask leaves a choice in every branch"}
PICTURES = {
    "a compressed observation is made of pngs of its height and width",
    "a compressed observations channels are those of its pngs",
}
DECLARED = "what the player sends beyond the base it declares"
OLD_TRAINERS = "a trainer without hybrid actions gets deprecated sizes too"
SIZE_VARIES = "an observation of variable size has two axes of which the first varies"
END_FIRST = "an end stands before the same agents next request"
STATISTICS = "the players own messages are whole"
# What only some scenes show; every other sentence comes to a judgement on all of them.
SOME_SCENES = {*MASKS, *PICTURES, DECLARED, OLD_TRAINERS, SIZE_VARIES, END_FIRST, STATISTICS}
# A scene that is over before an episode is.
ENDS = {"an agent has the same id in its next episode", "an ended agent is done with a last observation"}
NOT_SHOWN = {"announces_its_end": ENDS}
SHOWN = {
    "buffers_and_goal": {DECLARED, SIZE_VARIES},
    "corridor_like": {STATISTICS},
    "discrete_masks": {*MASKS, END_FIRST},
    "groups": {DECLARED},
    "hybrid": {*MASKS, DECLARED},
    "late_behavior": {OLD_TRAINERS},
    "pictures": {*PICTURES, DECLARED},
}


class Build(Conformance):
    """The stand-in with a scene; its processes write to one log."""

    def __init__(self, spec: str, log: Path) -> None:
        self._command = [UNITY / "Build.x86_64", "--spec", spec, "-logFile", log]

    def start_player(self, port: int, *arguments: str) -> Prepared:
        return Prepared([*self._command, "--mlagents-port", port, *arguments])


def results(spec: str, log: Path, topics=TOPICS) -> list[Result]:
    """The protocol's level on a scene."""
    found: list[Result] = []
    check(topics, Build(spec, log).start_player, found.append)
    return found


def shorter_play(session: Session, messages: int, *seconds: float, play=Session.play):
    """A quarter of the messages, except where the kit itself stops at the first that it looks for."""
    return play(session, messages if messages > 1000 else messages // 4, *seconds)


@pytest.mark.slow
@pytest.mark.parametrize("spec", SPECS)
def test_a_scene_of_unitys_passes_the_protocols_level(spec, tmp_path, monkeypatch):
    """One of them at the kit's full length; the sets above say what the others have to show in a quarter of it."""
    if spec != WHOLE:
        monkeypatch.setattr(Session, "play", shorter_play)
    topics = TOPICS if spec == WHOLE else OF_A_SCENE if spec in SHOWN else ENDS_AND_RESETS
    found = results(spec, tmp_path / "log", topics)
    assert {each.sentence: each.detail for each in found if each.verdict == "fail"} == {}
    judged = {each.sentence for each in found if each.verdict == "pass"}
    assert {each.sentence for each in found} - judged <= SOME_SCENES | NOT_SHOWN.get(spec, set())
    assert judged >= SHOWN.get(spec, set())
    assert all(each.detail for each in found if each.verdict == "not applicable")


@pytest.mark.slow
def test_a_scene_with_the_corridor_keeps_its_contract(tmp_path):
    found = results("corridor_like", tmp_path / "log", [CorridorContract])
    assert {each.sentence: each.detail for each in found if each.verdict != "pass"} == {}


@pytest.mark.parametrize("spec", ["discrete_masks", "hybrid"])
def test_the_kit_never_chooses_what_a_mask_forbids(spec, tmp_path):
    with Build(spec, tmp_path / "log").playing() as session:
        for _ in session.play(300):
            pass
        session.trainer.reply(quitting())
        session.exit_code()
    lines = (tmp_path / "log").read_text().splitlines()
    ledgers = [json.loads(line) for line in lines if line.startswith('{"id"')]
    assert sum(episode["decisions"] for agent in ledgers for episode in agent["episodes"]) > 100
    assert sum(agent["forbidden"] for agent in ledgers) == 0

"""The kit's own test: players with one fault each, and the sentence that must fail, alone.

Verdicts are ``pytest.fail``'s: all of this holds under ``python -O`` too, which strips ``assert``.
"""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import BIN
from faulty_players import FAULTS, WITHOUT_AGENTS, write_player
from prepared import Prepared

from trainer import conformance
from trainer.conformance import session
from trainer.conformance.checker import Result, check, sentences
from trainer.conformance.suite import needs, strict
from trainer.conformance.verdicts import NotApplicable, NotAsExpected, expect, expect_equal


@pytest.fixture(autouse=True)
def _shorter_plays(monkeypatch):
    """Some faults are that something never comes, for which the kit would wait in every sentence."""
    play = session.Session.play
    monkeypatch.setattr(session.Session, "play", lambda self, messages, *_: play(self, min(messages, 400)))
    monkeypatch.setattr(session, "EXIT_SECONDS", 5.0)


def results(topic: type[conformance.Conformance], player: Path, strict: bool = False, spec: str = "") -> list[Result]:
    """Runs the sentences of a topic, those of one level, on a player."""
    found: list[Result] = []

    def start(port: int, *arguments: str) -> Prepared:
        scene = ("--spec", spec) if spec else ()
        return Prepared([player, "--mlagents-port", port, *scene, *arguments])

    check([topic], start, found.append, strict)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_a_player_with_one_fault_fails_its_sentence_alone(name, tmp_path):
    fault = FAULTS[name]
    found = results(fault.topic, write_player(tmp_path, fault.code, fault.spec), fault.strict, fault.spec)
    failed = {result.sentence: result.detail for result in found if result.verdict == "fail"}
    if list(failed) != [fault.sentence.replace("_", " ")]:
        pytest.fail(f"{name}: {failed}")
    if not all(failed.values()):
        pytest.fail(f"{name}: not a word about what was seen")


def test_a_player_with_a_fault_fails_quickly_enough_for_every_day(tmp_path):
    """One sentence of one fault, so that the fast tests hold the kit to it too."""
    fault = FAULTS["wrong shape"]
    others = {each: None for each in sentences(fault.topic) if each != f"test_{fault.sentence}"}
    only = type(fault.topic.__name__, (fault.topic,), others)
    found = results(only, write_player(tmp_path, fault.code))
    if [result.verdict for result in found] != ["fail"]:
        pytest.fail(str(found))


@pytest.mark.slow
@pytest.mark.parametrize(
    "topic",
    [conformance.Episodes, conformance.Observations, conformance.Actions, conformance.VisualObservations],
    ids=lambda topic: topic.__name__,
)
def test_no_sentence_about_agents_passes_where_no_agent_was_seen(topic, tmp_path):
    found = results(topic, write_player(tmp_path, WITHOUT_AGENTS))
    passed = [result.sentence for result in found if result.verdict == "pass"]
    if passed or not found:
        pytest.fail(str(passed))


def kit_topic(**tests: object) -> type[conformance.Conformance]:
    """A topic as if it stood in the kit."""
    body = {"__module__": "trainer.conformance.made_up", "__doc__": "Made up.", **tests}
    return type("MadeUp", (conformance.Conformance,), body)


def test_a_sentence_without_a_judgement_is_not_applicable_and_says_why():
    def silent(self):
        for _ in ():
            expect(True, "", "")

    @needs("picture")
    def blind(self):
        pass

    def judged(self):
        expect(True, "", "")

    found: list[Result] = []
    check([kit_topic(test_silent=silent, test_blind=blind, test_judged=judged)], subprocess.Popen, found.append)
    seen = [(result.verdict, result.detail) for result in found]
    expected = [
        ("not applicable", "the player sent no message that this is about, so nothing was judged"),
        ("not applicable", "the player sent no picture, so nothing was judged"),
        ("pass", ""),
    ]
    if seen != expected:
        pytest.fail(str(seen))


def test_a_strict_sentence_is_run_only_where_it_is_asked_for():
    @strict
    def never(self):
        expect(False, "one thing", "another")

    topic = kit_topic(test_never=never)
    levels = []
    for level in (False, True):
        found: list[Result] = []
        check([topic], subprocess.Popen, found.append, strict=level)
        levels.append([(result.verdict, result.detail) for result in found])
    if levels != [[], [("fail", "one thing; another was expected")]]:
        pytest.fail(str(levels))
    with pytest.raises(NotApplicable, match="strict"):  # as pytest runs a subclass without ``strict = True``
        topic().test_never()


def test_an_authors_own_test_in_a_subclass_judges_as_it_likes():
    class Mine(conformance.Episodes):
        def test_mine(self):
            return

    Mine().test_mine()


def test_no_bare_assert_is_left_in_the_kit():
    modules = sorted(Path(conformance.__file__).parent.glob("*.py"))
    found = [
        f"{path.name}:{node.lineno}"
        for path in modules
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Assert)
    ]
    if len(modules) < 10 or found:
        pytest.fail(f"asserts in {len(modules)} modules: {found}")


def test_a_failure_says_what_came_and_what_was_expected():
    with pytest.raises(NotAsExpected, match="^no agents; at least one was expected$"):
        expect([], "no agents", "at least one")
    with pytest.raises(NotAsExpected, match="^exit code 1; 0 was expected$"):
        expect_equal(1, 0, "exit code")
    expect([1], "no agents", "at least one")
    expect_equal(0, 0, "exit code")


CHECK_OBSERVATIONS = """
import sys
from trainer.conformance import checker, observations
from trainer.main import main
checker.TOPICS, checker.is_corridor = [observations.Observations], lambda name: False
sys.exit(main(["check", "--env", sys.argv[1]]))
"""


def test_corridor_check_prints_a_table_and_fails_without_asserts_too(tmp_path):
    player = write_player(tmp_path, FAULTS["wrong shape"].code)
    command = [sys.executable, "-O", "-c", CHECK_OBSERVATIONS, player]
    wide = {**os.environ, "COLUMNS": "180"}  # each row on one line
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, env=wide)
    if run.returncode != 1 or "fail" not in run.stdout:
        pytest.fail(run.stdout)
    if "shape [14] with 13 values; 14 was expected" not in run.stdout:
        pytest.fail(run.stdout)


def test_corridor_check_of_nothing_says_so(tmp_path):
    run = subprocess.run([BIN / "corridor", "check", "--env", tmp_path / "none"], capture_output=True, text=True)
    if run.returncode != 1 or "There is no player" not in run.stderr:
        pytest.fail(run.stderr)


def test_corridor_check_of_a_program_that_is_no_player_says_so():
    arguments = ["check", "--env", "/bin/true", "--timeout-wait", "1"]
    run = subprocess.run([BIN / "corridor", *arguments], capture_output=True, text=True)
    if run.returncode != 1 or "The player does not play: the player sent nothing for 1 s" not in run.stderr:
        pytest.fail(run.stderr)

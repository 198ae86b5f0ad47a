"""What help says, and where somebody who mistyped is sent: to the help of the command that was meant."""

import re

import pytest

from trainer.command_line import COMMANDS
from trainer.commands.study import STUDIES
from trainer.main import main

EVERY = [*([name] for name in COMMANDS if name != "study"), *(["study", name] for name in STUDIES)]


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """The exit code, and all that was said, in one line and without a box around it."""
    try:
        code = main(arguments)
    except SystemExit as end:
        code = end.code
    output = capsys.readouterr()
    return code, " ".join(re.sub("[│╭╮╰╯─]", " ", output.out + output.err).split())


@pytest.fixture
def help_of(capsys):
    """A command's help as it is printed."""

    def of(*command: str) -> str:
        with pytest.raises(SystemExit):
            main([*command, "--help"])
        return capsys.readouterr().out

    return of


def test_the_options_of_train_stand_in_groups(help_of):
    _, *parts = re.split(r"^ ([\w ]*(?:options|arguments)) *$", help_of("train"), flags=re.MULTILINE)
    groups = dict(zip(parts[::2], parts[1::2], strict=True))
    named = [f"{name} options" for name in ("environment", "training", "connection", "restarts", "engine")]
    assert list(groups) == ["positional arguments", "options", *named]
    for option, group in {"--run-id": "options", "--env ": "environment options", "--c ": "training options"}.items():
        assert [name for name, part in groups.items() if re.search(rf"^ +{option}", part, re.MULTILINE)] == [group]


@pytest.mark.parametrize("command", EVERY, ids=" ".join)
def test_no_help_speaks_of_types(help_of, command):
    text = help_of(*command)
    assert re.findall(r"\{?None\b|\bSTR\b|\bINT\b|\bFLOAT\b|default: (?:False|\))", text) == []


def test_help_says_what_the_papers_terms_mean(help_of):
    text = " ".join(re.sub("│", "", help_of("train")).split())
    for term, meaning in {
        "curiosity ratio": "How much curiosity counts beside the environment's reward",
        "intrinsic curiosity module": "being wrong about what an action will change",
        "PPO ": "proximal policy optimisation",
        "agent steps": "How many decisions to learn from, all agents' together",
        "A player is": "the process that plays",
    }.items():
        assert term in text
        assert meaning in text


@pytest.mark.parametrize("command", EVERY, ids=" ".join)
def test_a_misspelt_option_is_sent_to_the_help_of_its_command(command, capsys):
    code, text = said(capsys, *command, "--stepz", "3")
    assert code == 2
    assert set(re.findall(r"corridor [\w -]*--help", text)) == {f"corridor {' '.join(command)} --help"}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["train", "--c", "banana"], "'banana' is not a number. .* see corridor train --help"),
        (["train", "--steps", "1.5"], "'1.5' is not a whole number. .* see corridor train --help"),
        (["study", "penalty", "--seeds", "x"], "'x' is not a whole number. .* see corridor study penalty --help"),
        (["train", "--algo", "dqn"], "invalid choice 'dqn' .* run corridor train --help"),
    ],
)
def test_a_value_of_another_kind_is_told_what_was_expected(arguments, says, capsys):
    code, text = said(capsys, *arguments)
    assert code == 2
    assert re.search(says, text)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            ["train", "--steps", "0"],
            "--steps is 0, but a whole number from 1 up was expected; see corridor train --help.",
        ),
        (["study", "penalty", "--seeds", "0"], "--seeds is 0, .*; see corridor study penalty --help."),
        (["study", "generalise", "r", "--episodes", "0"], "--episodes is 0, .*; see corridor study generalise --help."),
        (["watch", "--port", "70000"], "--port is 70000, but ports go from 1 to 65535; see corridor watch --help."),
    ],
)
def test_a_value_out_of_its_range_is_one_sentence_with_the_commands_help(arguments, says, capsys):
    code, text = said(capsys, *arguments)
    assert code == 1
    assert re.fullmatch(f"error: {says}", text)

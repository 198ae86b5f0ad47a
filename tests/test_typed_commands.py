"""Every command in the documents is one: its name, options and values are read as if somebody had typed them."""

import re
import shlex
import tomllib
from collections.abc import Callable, Iterator

import pytest
from test_docs import FENCE, PAGES, ROOT

from corridor_server.player_options import check_options, parser
from trainer.command_line import COMMANDS, ENV_ARGS, parse
from trainer.commands.study import STUDIES
from trainer.commands.train import Train
from trainer.run_options import RunOptions

OURS = '"$(which corridor-server)"'
BLOCK = re.compile(r"^```(?:sh|bash)?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
SETTINGS = re.compile(r"^(?:[A-Z_]+=(?:\"[^\"]*\"|\S*) )+")
# What is said of a command in general, and is no command line.
MENTIONS = {*COMMANDS, *(f"study {name}" for name in STUDIES)}


def corridor(arguments: list[str]) -> None:
    if " ".join(arguments) in MENTIONS or not arguments:
        return
    at = arguments.index(ENV_ARGS) if ENV_ARGS in arguments else len(arguments)
    typed, players = arguments[:at], arguments[at + 1 :]
    command = parse(typed)
    assert hasattr(command, "with_env_args") or not players
    if isinstance(command, Train) and command.file is None:
        assert command.run_id, "which a file may have"
    if "$(which corridor-server)" in typed:
        corridor_server(players)


def corridor_server(arguments: list[str]) -> None:
    if arguments != ["--gym"]:
        check_options(parser().parse_args(arguments))


def make(arguments: list[str]) -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert {each for each in arguments if "=" not in each} <= set(targets)
    for each in arguments:
        name, _, options = each.partition("ARGS=")
        if not name and options.startswith("--"):
            parse(["train", "--run-id", "r", *shlex.split(options)])


def pip(arguments: list[str]) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    place, named = re.fullmatch(r"(\.|curious-corridor)(?:\[([\w,]+)\])?", arguments[-1]).groups()
    assert place
    assert set((named or "trainer").split(",")) <= set(extras)


def docker(arguments: list[str]) -> None:
    files = [arguments[at + 1] for at, each in enumerate(arguments) if each == "-f"]
    assert all((ROOT / "docker" / name).is_file() for name in files)
    if "run" in arguments:
        service, *typed = [each for each in arguments[arguments.index("run") + 1 :] if each != "--rm"]
        assert service == "trainer"
        parse(typed)


def python(arguments: list[str]) -> None:
    assert arguments == ["-O"] or (ROOT / arguments[0]).is_file()


def others(arguments: list[str]) -> None:
    """Programs of others, whose options are theirs."""


PROGRAMS: dict[str, Callable[[list[str]], None]] = {
    "corridor": corridor,
    "corridor-server": corridor_server,
    "make": make,
    "pip": pip,
    "docker": docker,
    "python": python,
    **dict.fromkeys(("cd", "chmod", "git", "mlagents-learn", "ray", "source", "ssh", "tensorboard"), others),
}


def called(program: str) -> str:
    """A program's name, which may be typed with the folder that make installs it in."""
    return program.removeprefix(".venv/bin/")


def commands() -> Iterator[tuple[str, str]]:
    """Pages' names and their commands: lines of blocks that hold any, and code in sentences that begins as one."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for block in BLOCK.findall(text):
            lines = [line for line in block.replace("\\\n", " ").splitlines() if line.strip()]
            if any(called(line.split()[0]) in PROGRAMS for line in lines):
                yield from ((str(page.relative_to(ROOT)), line) for line in lines)
        for span in re.findall(r"`([^`]+)`", FENCE.sub("", text)):
            if called(span.split()[0]) in PROGRAMS:
                yield str(page.relative_to(ROOT)), " ".join(span.split())


def read(line: str) -> None:
    """One line; of what is written as alternatives (a|b) the first, and what is left out (...) is left out."""
    for command in re.sub(r"(?<=\w)(\|\w+)+", "", SETTINGS.sub("", line)).split(" && "):
        program, *arguments = shlex.split(command, comments=True)
        PROGRAMS[called(program)]([each for each in arguments if each != "..."])


@pytest.fixture
def only_our_files(monkeypatch):
    """A file that a reader has, and the repository doesn't, says nothing."""
    whole = RunOptions.read
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(RunOptions, "read", lambda path: whole(path) if path.is_file() else RunOptions())


@pytest.mark.parametrize(("page", "line"), sorted(set(commands())))
def test_a_command_of_the_documents_is_read_by_its_program(page, line, only_our_files):
    read(line)


@pytest.mark.parametrize(
    "line",
    [
        "corridor trian --run-id mine",
        "corridor train --run-id mine --stepz 3",
        "corridor train --num-envs 4",
        "corridor train --run-id mine --steps 0",
        f"corridor train --run-id mine --env {OURS} --env-args --gymm CartPole-v1",
        "corridor study penalties --seeds 3",
        "corridor-server --gym A --pettingzoo B",
        "make trian",
        "make train ARGS='--sed 3'",
        "pip install .[trainr]",
        "docker compose run --rm trainer evaluat mine",
        "curl https://example.com",
    ],
)
def test_one_that_is_wrong_would_be_seen(line, only_our_files):
    with pytest.raises((SystemExit, Exception)):
        read(line)


def test_the_readme_leads_to_the_tutorial_before_any_table():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme.index("(docs/unity.md)") < readme.index("\n|")

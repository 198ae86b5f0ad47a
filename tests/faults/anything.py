"""Gives every entry that takes a number, a path, an address or a file anything at all, in this process.

    python tests/faults/anything.py --cases 10000

An entry either does what it is asked for, up to where a player would start, or says in one sentence what is wrong with
it. Whatever else comes out is printed with what was given.
"""

import argparse
import collections
import contextlib
import http.client
import io
import json
import logging
import os
import re
import socket
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import yaml
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from mlagents_envs.exception import UnityException, UnityTimeOutException
from odd_values import ADDRESSES, FILES, HOSTS, NUMBERS, PATHS, TEXTS, VALUES, WRITTEN, YAML_VALUES

import corridor_server.main
from corridor_server.connection import ConnectionFailed
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.gym_env import CorridorEnv
from trainer import main as command
from trainer.bench import measure
from trainer.commands.train import Train
from trainer.conformance import checker
from trainer.errors import TrainerError
from trainer.players import opening
from trainer.players.communicator import ExchangeCommunicator
from trainer.players.location import place
from trainer.runs.folder import RunFolder
from trainer.studies import executors
from trainer.viewer.page_server import PageServer


def yaml_of(template: dict[str, Any], path: list[str], text: str) -> bytes:
    """A YAML file with one of its values replaced by a text."""
    mark = "MARK"
    inner: Any = template
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = mark
    return yaml.safe_dump(template, sort_keys=False).replace(mark, text, 1).encode("utf-8", "surrogatepass")


def leaves(values: dict[str, Any], path: tuple[str, ...] = ()) -> Iterator[list[str]]:
    """Where each value of nested ones is."""
    for name, value in values.items():
        yield [*path, name]
        if isinstance(value, dict):
            yield from leaves(value, (*path, name))


class NotOneSentenceError(AssertionError):
    """Something else came out than what was asked for, or a sentence."""


class Entries:
    """Everything that takes something from outside, in a folder of its own with one run in it.

    Args:
        folder: An empty one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.record = {"run": Train("run").run_config().as_dict()}
        self.places = list(leaves(self.record))
        self.run = RunFolder(folder / "results" / "run")
        (folder / "file").touch()
        self.server = PageServer(folder / "results", 0)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        self._reset()

    def close(self) -> None:
        """Ends the page's server."""
        self.server.shutdown()
        self.server.server_close()

    def _reset(self) -> None:
        self.run.checkpoints.mkdir(parents=True, exist_ok=True)  # a case may have been to train the run anew
        self.run.configuration.write_text(yaml.safe_dump(self.record, sort_keys=False))

    def corridor(self, *arguments: str) -> None:
        """The command, up to where a player would start."""
        says(command.main, list(arguments))

    def player(self, *arguments: str) -> None:
        """The player's command, up to where it would dial."""
        says(corridor_server.main.main, list(arguments))

    def options(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """Flags of every command."""
        counts = ("steps", "c", "seed", "num-envs", "num-areas", "penalty", "base-port", "timeout-wait", "time-scale")
        parameters = st.builds("{}={}".format, st.sampled_from(["goal_x", "\u00e9", ""]) | TEXTS, NUMBERS)
        choices: dict[str, dict[str, st.SearchStrategy[str]]] = {
            "train --run-id new --force": {
                **{f"--{name}": NUMBERS for name in counts},
                "--restarts-rate-limit-period-s": NUMBERS,
                "--env": ADDRESSES,
                "--listen": HOSTS,
                "--from-sb3": PATHS,
                "--config": PATHS,
                "--results-dir": WRITTEN,
                "--env-param": parameters,
            },
            "evaluate run": {"--episodes": NUMBERS, "--checkpoint": PATHS, "--env": ADDRESSES, "--listen": HOSTS},
            "replay run": {"--episodes": NUMBERS, "--checkpoint": PATHS, "--base-port": NUMBERS},
            "export run": {"--onnx": WRITTEN},
            "study penalty": {"--seeds": NUMBERS, "--first-seed": NUMBERS, "--jobs": NUMBERS, "--results-dir": WRITTEN},
            "study penalty --executor ray": {"--address": ADDRESSES},
            "study generalise run": {"--episodes": NUMBERS, "--timeout-wait": NUMBERS},
            "watch": {"--port": NUMBERS, "--results-dir": PATHS},
            "check": {"--env": ADDRESSES, "--timeout-wait": NUMBERS},
            "bench": {"--official": PATHS, "--json": WRITTEN, "--plot": WRITTEN, "--base-port": NUMBERS},
        }
        begin = draw(st.sampled_from(list(choices)))
        flags = draw(st.lists(st.sampled_from(list(choices[begin])), min_size=1, max_size=2, unique=True))
        self.corridor(*begin.split(), *(f"{flag}={draw(choices[begin][flag])}" for flag in flags))

    def names(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """Run names."""
        name = draw(PATHS)
        kind = draw(
            st.sampled_from(["evaluate", "replay", "export --onnx x.onnx", "train --run-id", "study generalise"])
        )
        if kind.startswith("train"):
            self.corridor("train", f"--run-id={name}", "--force")
        else:
            self.corridor(*kind.split(), "--", name) if name.startswith("-") else self.corridor(*kind.split(), name)

    def player_options(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """Flags of the player."""
        numbers = ("mlagents-port", "num-areas", "seed", "timeout-wait", "timeout-reply", "parent", "camera")
        flags = [*((f"--{name}", NUMBERS) for name in numbers), ("--host", HOSTS), ("--config", PATHS)]
        flag, values = draw(st.sampled_from([*flags, ("--camera", st.builds("{}x{}".format, NUMBERS, NUMBERS))]))
        self.player(f"{flag}={draw(values)}")

    def files(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """Files of settings, of both commands."""
        text = draw(YAML_VALUES)
        written = {
            "train": f"engine_settings: {{width: {text}}}\nenvironment_parameters:\n  opponent_speed: {text}\n",
            "server": f"opponent_speed: {text}\n",
        }
        which = draw(st.sampled_from(["train", "server"]))
        data = draw(st.just(written[which].encode()) | FILES)
        (self.folder / "settings.yaml").write_bytes(data)
        if which == "server":
            self.player("--config=settings.yaml")
        else:
            self.corridor("train", "--run-id", "new", "--force", "--config", "settings.yaml")

    def records(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """A run's files: its settings, and whatever else a command reads back."""
        self._reset()
        which = draw(st.sampled_from(["configuration", "summary", "progress", "trajectories", "checkpoint", "sb3"]))
        if which == "configuration":
            place = draw(st.sampled_from(self.places))
            copy = yaml.safe_load(yaml.safe_dump(self.record))
            data = draw(st.just(yaml_of(copy, place, draw(YAML_VALUES))) | FILES)
            self.run.configuration.write_bytes(data)
        else:
            paths = {"checkpoint": self.run.checkpoints / "step-0000000001.safetensors", "sb3": self.folder / "m.zip"}
            path = paths.get(which) or getattr(self.run, which)
            path.write_bytes(draw(FILES))
        try:
            if which == "sb3":
                self.corridor("train", "--run-id", "new", "--force", "--from-sb3", "m.zip")
            else:
                self.ask("GET", "/api/runs?run=run", None)
                self.ask("GET", "/api/scene?run=run", None)
                asked = draw(st.sampled_from(["evaluate run", "replay run", "export run --onnx x.onnx"]))
                self.corridor(*asked.split())
        finally:
            if which == "configuration":
                self._reset()
            else:
                path.unlink()

    def parameters(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """Keyword arguments of the environment, and its actions."""
        name = draw(st.sampled_from([*vars(CorridorConfig()), "area", "render_mode"]) | st.text(max_size=5))
        value = draw(VALUES)
        try:
            env = CorridorEnv(**{name: value})
            env.reset(seed=0)
            env.step(draw(VALUES))
        except ValueError as error:
            check_sentence(str(error))

    def drive(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """What a page asks the watching server."""
        begun = json.loads(self.ask("POST", "/api/drive/new", b"{}"))["session"]
        action = draw(st.lists(NUMBERS, min_size=1, max_size=3).map(lambda each: f"[{', '.join(each)}]") | TEXTS)
        session = draw(st.sampled_from([json.dumps(begun), "1", "[" * 2000 + "]" * 2000, "null"]))
        body = f'{{"session": {session}, "action": {action}}}'.encode("utf-8", "surrogatepass")
        self.ask("POST", "/api/drive/step", body)
        target = draw(TEXTS | st.sampled_from(["http://[x", "/api/scene?run=" + "a" * 300, "/?token=\x80"]))
        self.ask(
            "GET",
            target.encode("utf-8", "replace").decode("latin-1").translate(dict.fromkeys([*range(33), 127], "_")),
            None,
        )

    def ask(self, method: str, target: str, body: bytes | None) -> bytes:
        """An answer of the watching server, whose status is one that it gives on purpose."""
        address = "127.0.0.1", self.server.server_port
        asked = re.sub(r"[\x00-\x20\x7f]", "_", target).encode("utf-8", "surrogateescape") or b"/"
        headers = f"Host: {address[0]}:{address[1]}", f"X-Corridor-Token: {self.server.token}", "Connection: close"
        length = f"Content-Length: {len(body or b'')}"
        with socket.create_connection(address, timeout=600) as connection:
            lines = [method.encode() + b" " + asked + b" HTTP/1.1", *(each.encode() for each in (*headers, length))]
            connection.sendall(b"\r\n".join(lines) + b"\r\n\r\n" + (body or b""))
            answer = http.client.HTTPResponse(connection)
            answer.begin()
            data = answer.read()
        if answer.status not in (200, 400, 403, 404):
            raise NotOneSentenceError(f"status {answer.status}: {data[:200]!r}")
        return data

    def listening(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """Where a player is awaited."""
        host, port = draw(HOSTS), draw(st.integers(16800, 16803))
        try:
            _, listen, port = place(f"{host}:{port}", 0)
            ExchangeCommunicator(0, port, 1, listen).close()
        except (TrainerError, UnityException) as error:
            check_sentence(str(error))

    def case(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        """One entry with anything."""
        entries = (self.options, self.names, self.player_options, self.files, self.records, self.parameters)
        draw(st.sampled_from((*entries, self.drive, self.listening)))(draw)


def check_sentence(text: str) -> None:
    """Holds an error's message to being a sentence."""
    if len(text) < 15 or len(text) > 40_000 or "Traceback" in text:
        raise NotOneSentenceError(f"no sentence: {text[:300]!r}")


def says(main: Callable[[list[str]], int], arguments: list[str]) -> None:
    """Runs a command: it succeeds, or says in one sentence why not."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = main(arguments)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    if code not in (0, 1, 2) and (code, arguments[0]) != (130, "watch"):  # which is stopped as soon as it serves
        raise NotOneSentenceError(f"exit code {code}")
    if code and code != 130:
        check_sentence(said.getvalue())


def _log_here(path: str | None) -> None:
    logging.getLogger("corridor_server").handlers = [logging.StreamHandler(sys.stderr)]


@contextlib.contextmanager
def nothing_heavy(folder: Path) -> Iterator[None]:
    """Lets entries go as far as to a player's start, and no further."""
    stops = [
        (opening, "Environment", UnityTimeOutException("Nobody came.")),
        (corridor_server.main, "Connection", ConnectionFailed("No trainer listens there.")),
        (corridor_server.main, "_start_log", _log_here),
        (measure, "exchange_rates", TrainerError("It was not measured.")),
        (checker, "_behaviors", TrainerError("The player was not started.")),
        (executors.LocalExecutor, "run", TrainerError("The runs were not started.")),
        (PageServer, "serve_forever", KeyboardInterrupt()),
    ]
    former = Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.ExitStack() as stack:
            stack.enter_context(warnings.catch_warnings())
            warnings.simplefilter("ignore")
            for place_, name, error in stops:
                stack.enter_context(mock.patch.object(place_, name, side_effect=error))
            yield
    finally:
        os.chdir(former)
        logging.getLogger("corridor_server").handlers = []


def try_anything(
    cases: int, failed: Callable[[str, BaseException], None], *, derandomize: bool = False
) -> collections.Counter[str]:
    """Gives entries anything, so many times.

    Args:
        cases: How often.
        failed: Called with what was given and what came out, if that is neither success nor a sentence.
        derandomize: Always the same cases.

    Returns:
        How often each entry was tried.
    """
    tried: collections.Counter[str] = collections.Counter()
    with TemporaryDirectory() as temporary, contextlib.ExitStack() as stack:
        folder = Path(temporary)
        entries = Entries(folder)
        stack.callback(entries.close)
        stack.enter_context(nothing_heavy(folder))

        @settings(
            max_examples=cases,
            deadline=None,
            database=None,
            derandomize=derandomize,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(st.data())
        def one(data: st.DataObject) -> None:
            drawn: list[Any] = []

            def draw(strategy: st.SearchStrategy[Any]) -> Any:
                drawn.append(data.draw(strategy))
                return drawn[-1]

            try:
                entries.case(draw)
            except Exception as error:
                if type(error).__module__.startswith("hypothesis"):
                    raise
                failed(f"{drawn[0].__name__}{tuple(map(_short, drawn[1:]))}", error)
            tried[drawn[0].__name__] += 1

        one()
    return tried


def _short(value: object) -> str:
    try:
        return repr(value)[:200]
    except ValueError:
        return type(value).__name__


def main() -> int:
    """Runs the campaign; the exit code is 1 if something came out that should not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    options = parser.parse_args()
    kinds: collections.Counter[str] = collections.Counter()

    def failed(what: str, error: BaseException) -> None:
        kind = f"{type(error).__name__}: {str(error)[:80]!r}"
        kinds[kind] += 1
        if kinds[kind] <= 2:
            import traceback

            at = traceback.extract_tb(error.__traceback__)[-1]
            print(f"{what}\n    -> {kind}\n    {at.filename}:{at.lineno}", flush=True)

    began = time.monotonic()
    tried = try_anything(options.cases, failed)
    print(
        f"{sum(tried.values())} cases in {time.monotonic() - began:.0f} s: {dict(tried)}; {sum(kinds.values())} failed"
    )
    return 1 if kinds else 0


if __name__ == "__main__":
    raise SystemExit(main())

"""What tests share: a free port, a corridor whose numbers are easy by hand, and the commands under test."""

import collections
import contextlib
import io
import itertools
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from filelock import FileLock

import trainer  # noqa: F401 - makes mlagents_envs importable
from corridor_server.corridor import world
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.parameters import EpisodeParameters

BIN = Path(sys.executable).parent
WITH_ROWS = Path(__file__).with_name("corridor_with_rows.py")

hypothesis.settings.register_profile("untimed", deadline=None)  # a busy machine is no fault
hypothesis.settings.load_profile("untimed")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
FIREFOX = next(filter(None, map(shutil.which, ("firefox-esr", "firefox"))), None)
NO_WEBGL = """{
    const original = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
        return kind.startsWith("webgl") ? null : original.call(this, kind, ...rest);
    };
}"""
DESKTOP = {"width": 1280, "height": 860}
in_each_browser = pytest.mark.in_each_browser  # what browsers might do differently; the rest in Chromium alone
Open = Callable[..., Any]
# mlagents-envs 1.1.0's own pins. It says Python <= 3.10.12 and runs on later 3.10 ones, so it is installed by itself.
PINS = ("cloudpickle", "grpcio<=1.48.2", "Pillow", "protobuf<3.21", "pyyaml", "gym>=0.21", "pettingzoo==1.15.0")
MORE_PINS = ("numpy>=1.23.5,<1.24", "filelock>=3.4")

# Below those that the system gives to outgoing connections, of which one might have the next in a row; each of the
# processes that share the tests has its own.
_CANDIDATES = itertools.count(10_000 + 2_000 * int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]), 4)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with many slow tests come first: the last one that a worker begins should be short."""
    slow = collections.Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Every test says by name which browser it has."""
    if "browser" in metafunc.fixturenames:
        each = any(metafunc.definition.iter_markers("in_each_browser"))
        firefox = [pytest.param("firefox", marks=pytest.mark.slow)] if each else []  # it says all of it once more
        metafunc.parametrize("browser", ["chromium", *firefox], indirect=True)


def corridor_here(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Runs ``corridor`` in this process, which has imported everything: a process of its own takes seconds to."""
    from trainer.main import main

    typed, out, err = list(map(str, arguments)), io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(typed)
    return subprocess.CompletedProcess(typed, code, out.getvalue(), err.getvalue())


def unused_port() -> int:
    """The first of four ports in a row that nobody uses."""
    while True:
        first = next(_CANDIDATES)
        try:
            for port in range(first, first + 4):
                socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            continue
        return first


@pytest.fixture
def free_port() -> int:
    return unused_port()


@pytest.fixture
def open_corridor(free_port: int, tmp_path: Path) -> Iterator[Callable[..., object]]:
    """Opens our player through the real UnityEnvironment; closes what was opened."""
    from trainer.players.opening import open_environment

    opened = []

    def open_one(**options: object) -> object:
        defaults = {"seed": 1, "num_areas": 1, "port": free_port, "timeout_wait": 30, "log_folder": tmp_path}
        opened.append(open_environment("builtin", **{**defaults, **options}))  # type: ignore[arg-type]
        return opened[-1]

    yield open_one
    for environment in opened:
        if environment.is_open:
            environment.close()


@pytest.fixture
def register_gymnasium() -> Iterator[Callable[..., str]]:
    """Registers a class, with which an environment is then made."""
    import gymnasium

    names: list[str] = []

    def named(kind: Any, **options: Any) -> str:
        names.append(f"Mine{len(names)}-v0")
        gymnasium.register(names[-1], kind, **options)
        return names[-1]

    yield named
    for name in names:
        del gymnasium.registry[name]


@pytest.fixture
def play_gymnasium(register_gymnasium: Callable[..., str]) -> Iterator[Open]:
    """Makes a simulation of a Gymnasium environment, which is closed at the end."""
    from simulations.counting import Count

    from corridor_server.simulations.gymnasium_simulation import GymnasiumEnvironment, GymnasiumSimulation

    opened = []

    def one(kind: Any = Count, num_areas: int = 2, seed: int = 0, **options: Any) -> Any:
        name = kind if isinstance(kind, str) else register_gymnasium(kind)
        opened.append(GymnasiumSimulation(GymnasiumEnvironment(name, **options), seed, num_areas))
        return opened[-1]

    yield one
    for simulation in opened:
        simulation.close()


@pytest.fixture
def play_pettingzoo(monkeypatch: pytest.MonkeyPatch) -> Iterator[Open]:
    """Serves a class as a module's parallel_env or env; its arguments are those of ``arguments``."""
    from simulations.foxes_and_hares import Together

    from corridor_server.simulations.pettingzoo_simulation import PettingZooEnvironment, PettingZooSimulation

    opened = []

    def one(
        kind: Any = Together,
        num_areas: int = 1,
        seed: int = 0,
        function: str = "parallel_env",
        arguments: dict[str, Any] | None = None,
        **options: Any,
    ) -> Any:
        monkeypatch.setitem(sys.modules, "mine", types.SimpleNamespace(**{function: kind}))
        opened.append(PettingZooSimulation(PettingZooEnvironment("mine", arguments or {}, **options), seed, num_areas))
        return opened[-1]

    yield one
    for simulation in opened:
        simulation.close()


@pytest.fixture
def take_turns(play_pettingzoo: Open) -> Open:
    """Serves a class as a module's env, its agents in one behavior."""
    from simulations.turns import Turns

    def one(kind: Any = Turns, **options: Any) -> Any:
        return play_pettingzoo(kind, function="env", behaviors=(("player", re.compile(".*")),), **options)

    return one


@pytest.fixture
def page_server(tmp_path: Path) -> Iterator[Any]:
    """The page's server on the runs of an empty results folder."""
    from trainer.viewer.page_server import PageServer

    server = PageServer(tmp_path / "results", 0, seed=0)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture(scope="session")
def downloads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where Firefox puts what it downloads."""
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="session")
def served_chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of headless Chromium, with WebGL in software."""
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed (Debian: apt-get install chromium)")
    options = {"executablePath": CHROMIUM, "args": CHROMIUM_FLAGS}
    with served_browser("chromium", options, tmp_path_factory.mktemp("chromium")) as address:
        yield address


@pytest.fixture(scope="session")
def served_firefox(tmp_path_factory: pytest.TempPathFactory, downloads: Path) -> Iterator[str]:
    """The address of the system's own headless Firefox, over WebDriver BiDi, with WebGL in software."""
    if not (FIREFOX and shutil.which("Xvfb")):
        pytest.skip("Firefox or Xvfb is not installed (Debian: apt-get install firefox-esr xvfb)")
    with x_server() as display:
        options = {
            "channel": "moz-firefox",
            "executablePath": FIREFOX,
            "downloadsPath": str(downloads),
            "env": {**os.environ, "DISPLAY": display},
        }
        with served_browser("firefox", options, tmp_path_factory.mktemp("firefox")) as address:
            yield address


@contextlib.contextmanager
def served_browser(kind: str, options: dict[str, Any], folder: Path) -> Iterator[str]:
    """Starts a browser, which takes seconds, for all modules of this process; gives the address to connect to."""
    config = folder / "launch.json"
    config.write_text(json.dumps(options))
    command = [sys.executable, "-m", "playwright", "launch-server", "--browser", kind, "--config", config]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout
        try:
            address = process.stdout.readline().strip()
            assert address, f"{kind} did not start; what it said is above"
            yield address
        finally:
            os.killpg(process.pid, signal.SIGTERM)  # the driver, too, which closes the browser


@pytest.fixture(scope="module")  # the event loop of what connects must not be there for other modules
def browser(request: pytest.FixtureRequest) -> Iterator[Any]:
    """Chromium; or Firefox, where a test is marked ``in_each_browser``."""
    from playwright.sync_api import sync_playwright

    address = request.getfixturevalue(f"served_{request.param}")
    with sync_playwright() as playwright:
        browser = getattr(playwright, request.param).connect(address)
        yield browser
        browser.close()


@contextlib.contextmanager
def x_server() -> Iterator[str]:
    """The display of an X server without a screen, which Firefox needs for WebGL even where it is headless."""
    command = ["Xvfb", "-displayfd", "1", "-nolisten", "tcp"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout
        try:
            yield f":{process.stdout.readline().strip()}"
        finally:
            process.terminate()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Open]:
    """Opens an address; at the end, no page may have written an error to its console.

    Drawn in software, the first picture of the 3D view takes seconds, so only what is about it is opened ``in_3d``: the
    others see the page as a browser without WebGL shows it, with the top view in its place.
    """
    errors: list[str] = []
    contexts = []

    def open_one(address: str, *, in_3d: bool = False, **options: Any) -> Any:
        context = browser.new_context(**{"viewport": DESKTOP, **options})
        if not in_3d:
            context.add_init_script(NO_WEBGL)
        context.set_default_timeout(120_000)  # milliseconds; a busy machine draws slowly
        contexts.append(context)
        opened = context.new_page()
        opened.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        opened.on("pageerror", lambda error: errors.append(str(error)))
        opened.goto(address)
        return opened

    yield open_one
    for context in contexts:
        context.close()
    # A server that is gone, another, or without what it is asked for is what some tests are about; the browser reports
    # it by itself.
    expected = ("ERR_CONNECTION_REFUSED", "status of 403", "status of 400")
    assert [error for error in errors if not any(part in error for part in expected)] == []


def interpreter(version: str) -> str | None:
    """A Python of this version that runs, on the path or among pyenv's."""
    found = [shutil.which(f"python{version}"), *Path.home().glob(f".pyenv/versions/{version}.*/bin/python")]
    for candidate in found:
        if candidate and subprocess.run([candidate, "--version"], capture_output=True).returncode == 0:
            return str(candidate)
    return None


@pytest.fixture(scope="session")
def official_python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An interpreter with Unity's published client: ``OFFICIAL_PYTHON``, or one installed for these tests."""
    if given := os.environ.get("OFFICIAL_PYTHON"):
        return given
    python = interpreter("3.10")
    if python is None:
        pytest.skip("Unity's published client needs Python 3.10, and there is none on this machine")
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_TEST_RUN_UID" in os.environ:
        shared = shared.parent  # of all workers
    folder = shared / "official"
    with FileLock(f"{folder}.lock"):
        if not (folder / "whole").exists():
            pip = [str(folder / "bin" / "pip"), "install", "--quiet", "--no-compile"]
            subprocess.run([python, "-m", "venv", folder], check=True)
            subprocess.run([*pip, "setuptools<81", "wheel"], check=True)
            subprocess.run([*pip, *PINS, *MORE_PINS], check=True)
            subprocess.run([*pip, "--no-deps", "--ignore-requires-python", "mlagents-envs==1.1.0"], check=True)
            (folder / "whole").touch()
    return str(folder / "bin" / "python")


class OneArea:
    """A single area with everything placed by hand."""

    def __init__(self, **config: float) -> None:
        self.p = EpisodeParameters(CorridorConfig(**config), (0,)).columns  # type: ignore[arg-type]

    def state(
        self,
        position: tuple[float, float] = (0.0, 0.0),
        *,
        velocity: tuple[float, float] = (0.0, 0.0),
        goal: tuple[float, float] = (9.0, 0.0),
        switch_on: bool = False,
        opponents: tuple[tuple[float, float], ...] = ((-8.0, -4.0),),
        opponent_targets: tuple[tuple[float, float], ...] | None = None,
        episode_return: float = 0.0,
        episode_steps: int = 0,
    ) -> world.State:
        """By default the opponent stands still on its target, far from the learner."""
        zero = np.zeros(1, np.int64)
        return world.State(
            position=np.array([position]),
            velocity=np.array([velocity]),
            goal=np.array([goal]),
            switch_on=np.array([switch_on]),
            opponent_position=np.array([opponents]),
            opponent_velocity=np.zeros((1, len(opponents), 2)),
            opponent_target=np.array([opponents if opponent_targets is None else opponent_targets]),
            episode_return=np.array([episode_return]),
            episode_steps=np.array([episode_steps]),
            opponent_contacts=zero,
            wall_contacts=zero,
            closest_approach=np.array([9.0]),
        )

    def step(self, state: world.State, action: tuple[float, float] = (0.0, 0.0)) -> tuple[world.State, world.Outcome]:
        return world.step(self.p, state, np.array([action]))

    def reward(self, state: world.State, action: tuple[float, float] = (0.0, 0.0)) -> float:
        return float(self.step(state, action)[1].reward[0])


@pytest.fixture
def one_area() -> type[OneArea]:
    return OneArea

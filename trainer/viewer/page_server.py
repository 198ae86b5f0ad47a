"""What ``corridor watch`` does: the page over loopback HTTP, from runs' files, which it only reads."""

import hmac
import html
import json
import secrets
import socket
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from corridor_server.corridor.gym_env import CorridorEnv
from corridor_server.shared.given import Range, read_json, shown
from trainer.errors import TrainerError
from trainer.terminal import Terminal
from trainer.viewer.corridor_scene import corridor_facts, state_row
from trainer.viewer.document import page
from trainer.viewer.live import LiveEvaluations
from trainer.viewer.watched_runs import WatchedRuns

HOST = "127.0.0.1"
BODY_LIMIT = 4096  # bytes; a request's body is an action
FINITE = Range()
SESSIONS = 16  # drives that are remembered; a new one ends the oldest
CONNECTIONS = 32  # of which a browser keeps up to six
# What comes without a token: a page that was loaded again kept it for the tab that it is in.
REFUSAL = """<!doctype html>
<meta charset="utf-8">
<title>corridor watch</title>
<p>{}</p>
<script>
const token = location.search ? null : sessionStorage.getItem("corridor-token");
if (token) location.replace("/?token=" + encodeURIComponent(token));
</script>
"""


def watch(results_dir: Path, port: int, console: Terminal, ready: Callable[[str], None] | None = None) -> None:
    """Serves the page until Ctrl-C.

    Args:
        results_dir: The runs' folder; it need not exist yet.
        port: On loopback; 0 takes a free one.
        console: Told the address, which has the token in it.
        ready: Told it, too, once the page can be opened.

    Raises:
        TrainerError: The port is in use, or may not be opened.
    """
    try:
        server = PageServer(results_dir, port)
    except OSError as error:
        raise TrainerError(f"Port {port} can't be opened ({error.strerror}); choose another with --port.") from error
    try:
        console.print(f"Watching {results_dir}: open {server.address}")
        console.print("Ctrl-C ends it; training goes on.")
        if ready is not None:
            ready(server.address)
        server.serve_forever()
    finally:
        server.server_close()


class PageServer(ThreadingHTTPServer):
    """Answers loopback requests that carry its own name and token; has no files, only the page and its questions.

    Each connection has a thread. Beyond ``CONNECTIONS`` of them, a new one takes the place of the oldest that has not
    shown the token yet, however slowly that one sends.

    Args:
        results_dir: The runs' folder.
        port: On loopback; 0 takes a free one.
        seed: Decides the episodes that are driven by hand; None draws them anew each time.
    """

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, results_dir: Path, port: int, seed: int | None = None) -> None:
        self.results_dir = results_dir
        self.token = secrets.token_urlsafe(24)
        self.live = LiveEvaluations()
        self.runs = WatchedRuns(results_dir, self.live)
        self.drives = Drives(seed)
        self._connections: dict[Any, bool] = {}  # those that are open, oldest first: has it shown the token?
        self._places = threading.BoundedSemaphore(CONNECTIONS)
        self._lock = threading.Lock()
        super().__init__((HOST, port), _Handler)

    @property
    def address(self) -> str:
        """Where the page is, token included."""
        return f"http://{HOST}:{self.server_port}/?token={self.token}"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Gives a connection its thread, and its place."""
        with self._lock:
            if len(self._connections) == CONNECTIONS:
                oldest = next(iter(self._connections))
                gone = next((each for each, known in self._connections.items() if not known), oldest)
                del self._connections[gone]
                with suppress(OSError):
                    gone.shutdown(socket.SHUT_RDWR)  # its thread reads an end, and ends
        self._places.acquire()
        with self._lock:
            self._connections[request] = False
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Frees a connection's place."""
        with self._lock:
            self._connections.pop(request, None)
        super().shutdown_request(request)
        self._places.release()

    def keep(self, request: Any) -> None:
        """Notes that a connection has shown the token."""
        with self._lock:
            if request in self._connections:
                self._connections[request] = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Says nothing of connections that break: browsers close them at any time."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)

    def server_close(self) -> None:
        """Frees the port and ends the evaluating process."""
        super().server_close()
        self.live.close()


class Drives:
    """Episodes that somebody drives by hand, each in a world of its own.

    Args:
        seed: Decides the episodes; None draws them anew each time.
    """

    def __init__(self, seed: int | None = None) -> None:
        self._generator = np.random.default_rng(seed)
        self._sessions: OrderedDict[str, tuple[CorridorEnv, threading.Lock]] = OrderedDict()
        self._lock = threading.Lock()

    def new(self) -> dict[str, Any]:
        """Begins an episode; what the page needs to draw it."""
        env = CorridorEnv()
        session = secrets.token_urlsafe(12)
        with self._lock:
            observation, _ = env.reset(seed=int(self._generator.integers(2**31)))
            self._sessions[session] = env, threading.Lock()
            while len(self._sessions) > SESSIONS:
                self._sessions.popitem(last=False)
        return {
            "session": session,
            "corridor": corridor_facts(env.config),
            "goal": env.state.goal[0].tolist(),
            "opponent_targets": env.state.opponent_target[0].tolist(),
            "row": {"values": state_row(observation, 0.0, (0.0, 0.0)), "outcome": None},
        }

    def step(self, session: object, action: object) -> dict[str, Any]:
        """Applies an action for one decision.

        Raises:
            ValueError: There is no such drive, it is over, or the action is not two finite numbers.
        """
        key = session if isinstance(session, str) else ""
        with self._lock:
            found = self._sessions.get(key)
        if found is None:
            raise ValueError("This drive is over; begin a new episode.")
        numbers = [FINITE.read(value) for value in action] if isinstance(action, list) else []
        if len(numbers) != 2 or None in numbers:
            raise ValueError(f"The action is {shown(action)}, but two numbers in [-1, 1] were expected.")
        env, lock = found
        with lock:
            clipped = np.clip(np.array(numbers), -1.0, 1.0).astype(np.float32)
            observation, reward, terminated, truncated, info = env.step(clipped)
        outcome = None
        if terminated or truncated:
            outcome = "truncated" if truncated else "goal" if info["is_success"] else "failed"
            with self._lock:
                self._sessions.pop(key, None)
        return {"values": state_row(observation, reward, clipped), "outcome": outcome}


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    server_version = "corridor"
    sys_version = ""
    protocol_version = "HTTP/1.1"
    timeout = 60  # seconds that a silent connection is kept

    def do_GET(self) -> None:
        try:
            url = urlsplit(self.path)
        except ValueError:
            self._send(404, {"error": "There is nothing here."})
            return
        query = parse_qs(url.query)
        if url.path == "/":
            self._page(query)
        elif url.path == "/api/runs":
            self._answer(lambda: self.server.runs.overview(query.get("run", [])))
        elif url.path == "/api/scene":
            self._answer(lambda: self.server.runs.scene(query.get("run", [""])[0]))
        else:
            self._send(404, {"error": "There is nothing here."})

    def do_POST(self) -> None:
        body = self._body()
        if body is None:
            self.close_connection = True
            self._send(400, {"error": f"A JSON object of at most {BODY_LIMIT} bytes was expected."})
        elif self.path == "/api/drive/new":
            self._answer(self.server.drives.new)
        elif self.path == "/api/drive/step":
            self._answer(lambda: self.server.drives.step(body.get("session"), body.get("action")))
        else:
            self._send(404, {"error": "There is nothing here."})

    def _page(self, query: dict[str, list[str]]) -> None:
        problem = self._refusal(query.get("token", [""])[0])
        if problem:
            self._send(403, REFUSAL.format(html.escape(problem)))
            return
        data = {"mode": "watch", "token": self.server.token, "results": str(self.server.results_dir)}
        self._send(200, page(data))

    def _answer(self, ask: Callable[[], dict[str, Any]]) -> None:
        problem = self._refusal(self.headers.get("X-Corridor-Token", ""))
        if problem:
            self._send(403, {"error": problem})
            return
        try:
            self._send(200, ask())
        except (TrainerError, ValueError) as error:
            self._send(400, {"error": str(error)})

    def _refusal(self, token: str) -> str | None:
        """Why this request is not answered, or None. Another site's page can send neither our name nor our token."""
        hosts = [f"{name}:{self.server.server_port}" for name in (HOST, "localhost")]
        if self.headers.get("Host") not in hosts:
            return f"Only requests to {hosts[0]} are answered."
        if self.headers.get("Origin", f"http://{hosts[0]}") not in [f"http://{host}" for host in hosts]:
            return "Only this server's own page is answered."
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            return "This is another 'corridor watch' than the page's; open the address that it printed."
        self.server.keep(self.connection)
        return None

    def _body(self) -> dict[str, Any] | None:
        try:
            length = int(self.headers.get("Content-Length", "-1"))
            if not 0 <= length <= BODY_LIMIT:
                return None
            return read_json(self.rfile.read(length))
        except ValueError:
            return None

    def _send(self, status: int, body: dict[str, Any] | str) -> None:
        is_page = isinstance(body, str)
        data = (body if isinstance(body, str) else json.dumps(body, allow_nan=False)).encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{'text/html' if is_page else 'application/json'}; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("X-Frame-Options", "DENY")
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Says nothing: the terminal has the address in it."""

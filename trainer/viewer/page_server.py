"""What ``corridor watch`` does: the page over loopback HTTP, from runs' files, which it only reads."""

import hmac
import html
import json
import secrets
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from corridor_server.shared.given import read_json
from trainer.errors import TrainerError
from trainer.runs.folder import RunFolder
from trainer.terminal import Terminal
from trainer.viewer.document import page
from trainer.viewer.drives import Drives, one_episode
from trainer.viewer.live import LiveEvaluations
from trainer.viewer.watched_runs import WatchedRuns

HOST = "127.0.0.1"
BODY_LIMIT = 4096  # bytes; a request's body is an action
CONNECTIONS = 32  # of which a browser keeps up to six
# What comes without the token. A page that was loaded again kept it for the tab that it is in.
REFUSAL = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>corridor watch: no token</title>
<link rel="icon" href="data:,">
<style>
:root { color-scheme: light dark; }
html { background: #f7f7f5; color: #1e2227; }
@media (prefers-color-scheme: dark) { html { background: #15171a; color: #e7e7e3; } }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 34em; margin: 12vh auto; padding: 0 20px; }
</style>
</head>
<body>
<main>
<h1>This page needs its token</h1>
<p>%s</p>
</main>
<script>
const token = location.search ? null : sessionStorage.getItem("corridor-token");
if (token) location.replace("/?token=" + encodeURIComponent(token) + location.hash);
</script>
</body>
</html>
"""
NO_TOKEN = "The address has no token; open the whole address that 'corridor watch' printed, ?token= included."
OTHER_TOKEN = "This is another 'corridor watch' than the page's; open the address that it printed."


def watch(results_dir: Path, port: int, console: Terminal, ready: Callable[[str], None] | None = None) -> None:
    """Serves the page until Ctrl-C.

    Args:
        results_dir: The runs' folder; it need not exist yet.
        port: On loopback; 0 takes a free one.
        console: Told the address, which has the token in it.
        ready: Told it, too, once the page can be opened.

    Raises:
        TrainerError: ``results_dir`` is a file or a run, or the port is in use or may not be opened.
    """
    _check_results(results_dir)
    try:
        server = PageServer(results_dir, port)
    except OSError as error:
        raise TrainerError(f"Port {port} can't be opened ({error.strerror}); choose another with --port.") from error
    try:
        console.print(f"Watching {results_dir}: open {server.address}")
        if not results_dir.exists():
            console.print(f"There is no folder {results_dir} yet; is it the right --results-dir?", style="yellow")
        console.print("Ctrl-C ends it; training goes on.")
        if ready is not None:
            ready(server.address)
        server.serve_forever()
    finally:
        server.server_close()


def _check_results(results_dir: Path) -> None:
    """Refuses what can't have runs in it."""
    if results_dir.exists() and not results_dir.is_dir():
        raise TrainerError(f"--results-dir is {results_dir}, which is a file, but the folder of runs was expected.")
    if RunFolder(results_dir).configuration.is_file():
        raise TrainerError(
            f"--results-dir is {results_dir}, which is a run, but the folder with the runs was expected; give "
            f"{results_dir.parent}."
        )


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
        self.drives = Drives(results_dir, seed)
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
        elif url.path == "/api/episode":
            self._answer(
                lambda: one_episode(self.server.results_dir, query.get("run", [""])[0], query.get("number", [""])[0])
            )
        else:
            self._send(404, {"error": "There is nothing here."})

    def do_POST(self) -> None:
        body = self._body()
        if body is None:
            self.close_connection = True
            self._send(400, {"error": f"A JSON object of at most {BODY_LIMIT} bytes was expected."})
        elif self.path == "/api/drive/new":
            self._answer(lambda: self.server.drives.new(*map(body.get, ("run", "episode", "seed"))))
        elif self.path == "/api/drive/step":
            self._answer(lambda: self.server.drives.step(body.get("session"), body.get("action")))
        else:
            self._send(404, {"error": "There is nothing here."})

    def _page(self, query: dict[str, list[str]]) -> None:
        problem = self._refusal(query.get("token", [""])[0])
        if problem:
            self._send(403, REFUSAL % html.escape(problem))
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
            return OTHER_TOKEN if token else NO_TOKEN
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

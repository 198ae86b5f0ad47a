"""Asking the page's server as the page does, and reading where it is."""

import http.client
import json
import subprocess

from trainer.viewer.page_server import PageServer


def address_of(process: "subprocess.Popen[str]") -> str:
    """The address that ``corridor watch`` prints, after what it says while it starts."""
    assert process.stdout
    line = next(line for line in process.stdout if "http://127.0.0.1:" in line)
    return line.split()[-1]


def ask(page_server: PageServer, path: str, body: object = None, **headers: str | None) -> tuple[int, dict]:
    sent = {"X-Corridor-Token": page_server.token, **{name.replace("_", "-"): text for name, text in headers.items()}}
    connection = http.client.HTTPConnection("127.0.0.1", page_server.server_port, timeout=30)
    try:
        data = body if isinstance(body, str | None) else json.dumps(body)
        method = "GET" if body is None else "POST"
        connection.request(method, path, data, {name: text for name, text in sent.items() if text is not None})
        answer = connection.getresponse()
        text = answer.read().decode()
        return answer.status, json.loads(text) if text.startswith("{") else {"page": text}
    finally:
        connection.close()

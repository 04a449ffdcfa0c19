"""The page on this machine: a fixed table of names over HTTP on 127.0.0.1, for this page alone."""

from __future__ import annotations

import errno
import select
import socket
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from bicycle_env.explore.answers import LARGEST, Answers, SupersededError

ADDRESS, USUAL_PORT = "127.0.0.1", 8765
KINDS = {"html": "text/html", "css": "text/css", "mjs": "text/javascript"}
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; "
    "form-action 'none'"
)
"""What a browser may load for the page; ``index.html`` says the same where no server does."""
HEADERS = {
    "Content-Security-Policy": f"{POLICY}; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Server(ThreadingHTTPServer):
    """Gives what is in a table of names and contents, and answers questions: no path of a client reaches the disk.

    Attributes: ``url``.

    Args:
        files: contents by name; "index.html" is given for "/" too.
        port: of 127.0.0.1; 0 for any that is free.

    Raises:
        OSError: the port is taken, or not this user's to take; one line says what to do.
    """

    daemon_threads = True
    allow_reuse_address = False  # elsewhere than on Unix it would take a port from another server

    def __init__(self, files: Mapping[str, bytes], port: int = USUAL_PORT) -> None:
        self.table = {f"/{name}": (_kind(name), content) for name, content in files.items()}
        self.table["/"] = self.table["/index.html"]
        self.answers = Answers()
        try:
            super().__init__((ADDRESS, port), Handler)
        except OSError as error:
            why = "is in use" if error.errno == errno.EADDRINUSE else f"cannot be opened ({error.strerror})"
            raise OSError(f"port {port} {why}: choose another with --port, or 0 for any that is free") from None
        self.hosts = {f"{host}:{self.server_port}" for host in (ADDRESS, "localhost")}
        self.url = f"http://{ADDRESS}:{self.server_port}/"


def _kind(name: str) -> str:
    return f"{KINDS[name.rpartition('.')[2]]}; charset=utf-8"


class Handler(BaseHTTPRequestHandler):
    """GET and HEAD of the server's table; POST of a question, see :class:`Answers`, to ``/answer``."""

    server: Server
    server_version, sys_version = "bicycle-env", ""
    timeout = 10.0  # s, for a client that asks for nothing

    def do_GET(self) -> None:
        """Refuses requests that another site's page sends (Origin), or under another site's name (Host)."""
        if self._is_refused(self.headers.get_all("Origin", [])):
            return
        if self.path not in self.server.table:
            self._say(404, "there is no such file")
            return
        self._give(200, *self.server.table[self.path])

    do_HEAD = do_GET  # noqa: N815 (the name that the standard library calls)

    def do_POST(self) -> None:
        """Refuses as GET does, and what does not say that it is this page (no Origin), large or no JSON."""
        if self._is_refused(self.headers.get_all("Origin", [""])):
            return
        length = self.headers.get("Content-Length", "")
        if self.path != "/answer":
            self._say(404, "questions go to /answer")
        elif self.headers.get_content_type() != "application/json":
            self._say(415, "a question must be application/json")
        elif not (length.isascii() and length.isdigit()):
            self._say(411, "a question must say its length")
        elif len(length) > 6 or int(length) > LARGEST:
            self._say(413, f"a question must have at most {LARGEST} bytes")
        else:
            self._answer(self.rfile.read(int(length)))

    def _answer(self, question: bytes) -> None:
        try:
            self._give(200, "application/json", self.server.answers.answer(question, self._is_gone))
        except SupersededError:
            self._give(200, "application/json", b"null")  # no error: browsers would report one
        except (ValueError, TypeError) as error:
            self._say(400, str(error))

    def _is_gone(self) -> bool:
        """Whether the client has closed the connection, on which it has nothing more to say."""
        try:
            readable, _, _ = select.select([self.connection], [], [], 0)
            return bool(readable) and self.connection.recv(1, socket.MSG_PEEK) == b""
        except OSError:
            return True

    def _is_refused(self, origins: list[str]) -> bool:
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0] not in self.server.hosts:
            self._say(403, "this page is served to this machine alone")
            return True
        if any(origin.removeprefix("http://") not in self.server.hosts for origin in origins):
            self._say(403, "another site's page may not ask")
            return True
        return False

    def _say(self, status: int, words: str) -> None:
        self.close_connection = True  # what of the request was not read is not a next one
        self._give(status, "text/plain; charset=utf-8", f"{words}\n".encode())

    def _give(self, status: int, kind: str, content: bytes) -> None:
        try:
            self.send_response(status)
            for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
                self.send_header(name, value)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(content)
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True  # the page has asked for something else since

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is written: what a client asks for is no news."""

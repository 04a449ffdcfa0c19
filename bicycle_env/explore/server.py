"""The page on this machine: a fixed table of names over HTTP on 127.0.0.1, for this page alone."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

ADDRESS, USUAL_PORT = "127.0.0.1", 8765
KINDS = {"html": "text/html", "css": "text/css", "mjs": "text/javascript"}
POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; img-src data:; base-uri 'none'; form-action 'none'"
"""What a browser may load for the page; ``index.html`` says the same where no server does."""
HEADERS = {
    "Content-Security-Policy": f"{POLICY}; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Server(ThreadingHTTPServer):
    """Gives what is in a table of names and contents, and nothing else: no path of a client reaches the disk.

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
    """GET and HEAD of the server's table."""

    server: Server
    server_version, sys_version = "bicycle-env", ""
    timeout = 10.0  # s, for a client that asks for nothing

    def do_GET(self) -> None:
        """Refuses requests that another site's page sends (Origin), or under another site's name (Host)."""
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        if len(hosts) != 1 or hosts[0] not in self.server.hosts:
            return self._give(403, "text/plain", b"this page is served to this machine alone\n")
        if any(origin.removeprefix("http://") not in self.server.hosts for origin in origins):
            return self._give(403, "text/plain", b"another site's page may not ask\n")
        if self.path not in self.server.table:
            return self._give(404, "text/plain", b"there is no such file\n")
        return self._give(200, *self.server.table[self.path])

    do_HEAD = do_GET  # noqa: N815 (the name that the standard library calls)

    def _give(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is written: what a client asks for is no news."""

"""The server gives what is in its table, to this machine's own page alone."""

import http.client
import json
import socket
import threading

import pytest

from bicycle_env.cli import main
from bicycle_env.explore import Server

FILES = {"index.html": b"<p>here</p>", "main.mjs": b"export {};"}


@pytest.fixture(scope="module")
def server():
    with Server(FILES, 0) as made:
        thread = threading.Thread(target=made.serve_forever, args=(0.02,))
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def ask(server, path="/", method="GET", host=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    connection.putrequest(method, path, skip_host=True)
    if host != "":
        connection.putheader("Host", host or f"127.0.0.1:{server.server_port}")
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer, content


@pytest.mark.parametrize(
    ("path", "name", "kind"),
    [("/", "index.html", "html"), ("/index.html",) * 2 + ("html",), ("/main.mjs",) * 2 + ("javascript",)],
)
def test_what_is_in_the_table_is_given(server, path, name, kind):
    answer, content = ask(server, path)
    assert (answer.status, content) == (200, FILES[name.removeprefix("/")])
    assert kind in answer.headers["Content-Type"]
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    allowed = answer.headers["Content-Security-Policy"]
    assert allowed.startswith("default-src 'none'; script-src 'self'")
    assert "http" not in allowed
    assert ask(server, path, "HEAD")[1] == b""


@pytest.mark.parametrize(
    "path", ["/other", "/../pyproject.toml", "/%2e%2e/pyproject.toml", "//etc/passwd", "/index.html?a", "*"]
)
def test_nothing_else_is(server, path):
    assert ask(server, path)[0].status == 404


@pytest.mark.parametrize("host", ["", "evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:80"])
def test_a_foreign_host_is_refused(server, host):
    assert ask(server, host=host)[0].status == 403


@pytest.mark.parametrize("origin", ["null", "https://evil.example", "http://127.0.0.1:1", ""])
def test_a_foreign_origin_is_refused(server, origin):
    assert ask(server, Origin=origin)[0].status == 403
    own = f"http://localhost:{server.server_port}"
    assert ask(server, host=own.removeprefix("http://"), Origin=own)[0].status == 200


def test_other_methods_are_refused(server):
    assert ask(server, method="PUT")[0].status == 501


QUESTION = b'{"ask": "design", "vehicle": "oversteer", "speed": 43.0}'


def question(server, content=QUESTION, path="/answer", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60)
    own = f"http://127.0.0.1:{server.server_port}"
    usual = {"Origin": own, "Content-Type": "application/json", "Content-Length": str(len(content))}
    connection.putrequest("POST", path)
    for name, value in {**usual, **headers}.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders()
    connection.send(content)
    answer = connection.getresponse()
    found = answer.read()
    connection.close()
    return answer.status, found


def test_a_question_is_answered(server):
    status, content = question(server)
    assert status == 200
    assert len(json.loads(content)["weights"]) == 2


@pytest.mark.parametrize(
    ("status", "changes"),
    [
        (403, {"Origin": None}),
        (403, {"Origin": "https://evil.example"}),
        (404, {"path": "/answers"}),
        (404, {"path": "/"}),
        (415, {"Content-Type": "text/plain"}),
        (415, {"Content-Type": None}),
        (411, {"Content-Length": None}),
        (411, {"Content-Length": "-1"}),
        (413, {"Content-Length": "5000"}),
        (413, {"Content-Length": "9" * 5000}),
        (400, {"content": b'{"ask": "design", "vehicle": "<b>", "speed": 43.0}'}),
    ],
)
def test_a_question_that_is_refused(server, status, changes):
    found, content = question(server, **changes)
    assert found == status
    assert content.count(b"\n") == 1


def test_a_port_in_use_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("bicycle_env.explore.page", lambda served: FILES)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["explore", "--no-browser", "--port", str(port)]) == 2
    assert f"error: port {port} is in use: choose another with --port" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [(("--port", "70000"), "--port must be"), (("--out", "x", "--port", "1"), "no meaning with --out")],
)
def test_bad_words_are_one_line(words, complaint, capsys):
    assert main(["explore", *words]) == 2
    assert complaint in capsys.readouterr().err

"""What happens between this package and a service: waiting, TLS, broken answers."""

from __future__ import annotations

import http.server
import json
import pickle
import socket
import threading
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import polars as pl
import pytest
from conftest import Service, self_signed

from palpate import Palpate, PalpateError

BUILDING = "the query engine is built first, once: about ten minutes on two cores; ask again then"
Handler = http.server.BaseHTTPRequestHandler


@contextmanager
def between(answer: Callable[[Handler], None]) -> Iterator[str]:
    """A server that answers requests in this way; its address."""

    class Between(Handler):
        def do_GET(self) -> None:
            answer(self)

        do_POST = do_GET

        def log_message(self, format: str, *args: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Between) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


def reply(handler: Handler, status: int, body: bytes, headers: dict[str, str | None]) -> None:
    """Answers with this body, and the headers that are not None."""
    handler.send_response(status)
    for name, value in ({"Content-Length": str(len(body))} | headers).items():
        if value is not None:
            handler.send_header(name, value)
    handler.end_headers()
    handler.wfile.write(body)


def refuse(handler: Handler, status: int, detail: str, retry_after: str | None) -> None:
    """Answers with a problem body."""
    body = json.dumps({"type": "about:blank", "title": "T", "status": status, "detail": detail}).encode()
    reply(handler, status, body, {"Retry-After": retry_after})


def passed_on(handler: Handler, service: Service) -> None:
    """Answers with what the service answers."""
    length = int(handler.headers.get("Content-Length", 0))
    body = handler.rfile.read(length) if length else None
    request = urllib.request.Request(
        service.url + handler.path, body, {"Content-Type": "application/json"}, method=handler.command
    )
    with urllib.request.urlopen(request) as answer:
        reply(handler, 200, answer.read(), {})


def test_a_question_waits_for_the_query_engine_and_shows_it(
    service: Service, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[str] = []

    def answer(handler: Handler) -> None:
        asked.append(handler.path)
        if len(asked) <= 2:
            refuse(handler, 503, BUILDING, "0")
        else:
            passed_on(handler, service)

    with between(answer) as url:
        assert Palpate(url).sql("SELECT COUNT(trial_id) AS n FROM trials")["n"][0] == 266
    assert len(asked) == 3
    shown = capsys.readouterr().err.splitlines()
    assert shown == [f"palpate: {BUILDING}; asks again every 0 s"]


def test_waiting_has_an_end(capsys: pytest.CaptureFixture[str]) -> None:
    with between(lambda handler: refuse(handler, 503, BUILDING, "30")) as url:
        with pytest.raises(PalpateError, match="the query engine is built first") as refused:
            Palpate(url, wait_s=10).sql("SELECT 1")
    assert refused.value.status == 503 and capsys.readouterr().err == ""


def test_a_refusal_that_does_not_pass_is_not_repeated() -> None:
    asked: list[str] = []

    def answer(handler: Handler) -> None:
        asked.append(handler.path)
        refuse(handler, 503, "no engine", None)

    with between(answer) as url, pytest.raises(PalpateError, match=r"no engine \(HTTP 503\)"):
        Palpate(url).runs()
    assert len(asked) == 1


def test_a_redirect_is_not_followed_with_the_key() -> None:
    asked: list[str] = []

    def away(handler: Handler) -> None:
        asked.append(handler.path)
        reply(handler, 302, b"", {"Location": "/elsewhere"})

    with between(away) as url, pytest.raises(PalpateError) as refused:
        Palpate(url, "palpate_key").runs()
    assert refused.value.status == 302 and asked == ["/api/v1/runs?limit=1000"]


def test_an_incomplete_answer_is_an_error() -> None:
    with between(lambda handler: reply(handler, 200, b"{", {"Content-Length": "1000"})) as url, pytest.raises(PalpateError, match="incomplete") as broken:
        Palpate(url).runs()
    assert broken.value.status is None


def test_nothing_that_answers_is_an_error_with_what_to_do() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(PalpateError, match=f"no service at http://127.0.0.1:{port}: start `palpate serve`"):
        Palpate(f"http://127.0.0.1:{port}").runs()


def test_silence_has_an_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(PalpateError, match="no answer for"):
            Palpate(url, timeout_s=0.2).runs()


def test_tls_trusts_the_certificate_of_the_service_whatever_its_name(guarded: Service) -> None:
    cert = guarded.data / "cert.pem"
    lab = Palpate(guarded.url, guarded.key, ca=cert)
    assert len(lab.runs()) == 2
    # The file is kept on this machine, because polars can send neither key nor certificate.
    assert lab.dataset("real").scan().select(pl.len()).collect().item() == len(lab.dataset("real"))


def test_tls_refuses_another_certificate(guarded: Service, tmp_path: Path) -> None:
    with pytest.raises(PalpateError, match="state its certificate as ca=") as unknown:
        Palpate(guarded.url, guarded.key).runs()
    assert unknown.value.status is None
    other = tmp_path / "other.pem"
    self_signed(other, "other")
    with pytest.raises(PalpateError, match="certificate"):
        Palpate(guarded.url, guarded.key, ca=other).runs()


def test_errors_survive_a_worker_process() -> None:
    error = PalpateError(400, "no", title="Bad Request", errors=({"key": "sql"},))
    again = pickle.loads(pickle.dumps(error))
    assert (again.status, again.detail, again.title, again.errors) == (400, "no", "Bad Request", ({"key": "sql"},))

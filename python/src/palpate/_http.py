"""Requests to one service, by the standard library alone.

Uses: http.client. Never: a redirect or a proxy (they could get the key), a request that changes
anything on the service.
"""

import http.client
import io
import json
import os
import re
import socket
import ssl
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote, urlencode, urlsplit

from palpate._error import PalpateError, refused

DEFAULT_URL = "http://127.0.0.1:8080"
PREFIX = "/api/v1"
# Refusals that pass: too many requests, and a query engine that is busy or being built.
PASSING = (429, 503)
# Bytes that are copied at once from a response to a file.
PIECE_BYTES = 1 << 20

Parameters = dict[str, str | int | float | bool | None]


@dataclass(frozen=True)
class Answer:
    """A response that the service did not refuse."""

    body: bytes
    next_path: str | None
    """Path of the next page, from the header ``Link``."""

    def json(self) -> Any:
        """The body as JSON."""
        return json.loads(self.body)


class Service:
    """A service, and how it is reached. Has no state between requests: threads may share it.

    ``url``: default ``PALPATE_URL``, then the service of this machine.
    ``key``: default ``PALPATE_KEY``, then the content of the file ``PALPATE_KEY_FILE``.
    ``ca``: a PEM file with the certificate of the service, or of its authority, the only ones that
    are then trusted; default ``PALPATE_CA``, then the authorities of the system.
    ``timeout_s``: longest silence of the service. ``wait_s``: longest time that a request is
    repeated while the service refuses it with 429 or 503.
    """

    def __init__(
        self,
        url: str | None,
        key: str | None,
        ca: str | os.PathLike[str] | None,
        timeout_s: float,
        wait_s: float,
    ) -> None:
        self.url = (url or os.environ.get("PALPATE_URL") or DEFAULT_URL).rstrip("/")
        parts = urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(f"url = {self.url}: must be http:// or https:// and a host")
        self._secure, self._host = parts.scheme == "https", parts.hostname
        self._port, self._base = parts.port, parts.path
        self._key = key or _key_of_environment()
        self._ca = ca or os.environ.get("PALPATE_CA") or None
        self._timeout_s, self._wait_s = timeout_s, wait_s

    @property
    def reads_by_url_alone(self) -> bool:
        """Whether a program that knows only the URL gets an answer."""
        return self._key is None and self._ca is None

    def get(self, path: str, parameters: Parameters | None = None) -> Answer:
        """Gets a path below ``/api/v1``."""
        return self.ask("GET", address(path, parameters), None)

    def query(self, statement: str) -> Answer:
        """Asks for the rows of a SELECT statement, as an Arrow stream."""
        body = json.dumps({"sql": statement, "format": "arrow"}).encode()
        return self.ask("POST", f"{PREFIX}/query", body)

    def follow(self, path: str) -> Answer:
        """Gets the next page."""
        return self.ask("GET", path, None)

    def download(self, path: str, parameters: Parameters | None, file: BinaryIO) -> None:
        """Copies a body to a file, piece by piece."""
        self.ask("GET", address(path, parameters), None, file)

    def ask(self, method: str, target: str, body: bytes | None, file: BinaryIO | None = None) -> Answer:
        """Sends a request, again while the service refuses it for now.

        Raises ``PalpateError`` if it is refused for good, or nothing answers.
        """
        until, shown = time.monotonic() + self._wait_s, ""
        while True:
            try:
                answer = self._once(method, target, body, file)
            except (OSError, http.client.HTTPException) as error:
                raise PalpateError(None, self._unreachable(error)) from error
            if isinstance(answer, Answer):
                return answer
            refusal, pause_s = answer
            if pause_s is None or time.monotonic() + pause_s > until:
                raise refusal
            if refusal.detail != shown:
                shown = refusal.detail
                print(f"palpate: {shown}; asks again every {pause_s:.0f} s", file=sys.stderr, flush=True)
            time.sleep(pause_s)

    def _once(
        self, method: str, target: str, body: bytes | None, file: BinaryIO | None
    ) -> Answer | tuple[PalpateError, float | None]:
        """One request: the answer, or the refusal with the time after which another may succeed."""
        headers = {"Accept-Encoding": "identity", "User-Agent": "palpate-python/0.1"}
        if self._key is not None:
            headers["Authorization"] = f"Bearer {self._key}"
        if body is not None:
            headers["Content-Type"] = "application/json"
        connection = self._connection()
        try:
            connection.request(method, self._base + target, body, headers)
            response = connection.getresponse()
            if response.status == 200:
                if file is not None:
                    _copy(response, file)
                    return Answer(b"", None)
                whole = io.BytesIO()
                _copy(response, whole)
                return Answer(whole.getvalue(), next_path(response.headers.get("Link")))
            error = refused(response.status, response.reason, response.read())
            pause = response.headers.get("Retry-After", "")
            passing = response.status in PASSING and re.fullmatch(r"\d+", pause)
            return error, max(float(pause), 0.1) if passing else None
        finally:
            connection.close()

    def _connection(self) -> http.client.HTTPConnection:
        if not self._secure:
            return http.client.HTTPConnection(self._host, self._port, timeout=self._timeout_s)
        context = ssl.create_default_context(cafile=self._ca)
        own = _certificates(self._ca) if self._ca else frozenset()
        return _Pinned(self._host, self._port, self._timeout_s, context, own)

    def _unreachable(self, error: Exception) -> str:
        if isinstance(error, ConnectionRefusedError | socket.gaierror):
            return f"no service at {self.url}: start `palpate serve`, or name another in PALPATE_URL"
        if isinstance(error, ssl.SSLError):
            return f"{self.url}: {error}; state its certificate as ca=.. or in PALPATE_CA"
        if isinstance(error, TimeoutError):
            return f"{self.url}: no answer for {self._timeout_s:.0f} s (timeout_s)"
        if isinstance(error, http.client.IncompleteRead):
            return f"{self.url}: the answer is incomplete: ask again"
        return f"{self.url}: {error or type(error).__name__}"


class _Pinned(http.client.HTTPSConnection):
    """HTTPS to a service whose own certificate may be in the file: then its name and date do not
    matter, as in the commands of `palpate`. Nothing is sent before the certificate is accepted."""

    def __init__(
        self,
        host: str,
        port: int | None,
        timeout_s: float,
        context: ssl.SSLContext,
        own: frozenset[bytes],
    ) -> None:
        super().__init__(host, port, timeout=timeout_s, context=context)
        self._own = own

    def connect(self) -> None:
        """Connects, and checks the certificate."""
        try:
            super().connect()
        except ssl.SSLCertVerificationError as error:
            # Not `close`: it would also end the request that this connection is opened for.
            self.sock.close()
            if not self._own:
                raise
            any_certificate = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            any_certificate.check_hostname = False
            any_certificate.verify_mode = ssl.CERT_NONE
            plain = socket.create_connection((self.host, self.port), self.timeout)
            self.sock = any_certificate.wrap_socket(plain, server_hostname=self.host)
            if self.sock.getpeercert(binary_form=True) not in self._own:
                self.sock.close()
                raise error from None


def _copy(response: http.client.HTTPResponse, file: BinaryIO) -> None:
    """Copies a body to a file through one piece of memory.

    ``response.read()`` takes 1.6 times the processor time: it keeps all pieces, and then joins them in new memory.
    """
    piece = memoryview(bytearray(PIECE_BYTES))
    while count := response.readinto(piece):
        file.write(piece[:count])
    if response.length:
        raise http.client.IncompleteRead(b"", response.length)


def address(path: str, parameters: Parameters | None = None) -> str:
    """The address of a path below ``/api/v1`` with its parameters; absent ones are None.

    >>> address("/trials", {"limit": 3, "columns": None, "voltages": True})
    '/api/v1/trials?limit=3&voltages=true'
    """
    named = {
        name: str(value).lower() if isinstance(value, bool) else value
        for name, value in (parameters or {}).items()
        if value is not None
    }
    return PREFIX + quote(path) + (f"?{urlencode(named)}" if named else "")


def next_path(link: str | None) -> str | None:
    """The path of the next page, if there is one.

    >>> next_path('</api/v1/trials?limit=2&cursor=NA>; rel="next"')
    '/api/v1/trials?limit=2&cursor=NA'
    >>> next_path(None)
    """
    found = re.search(r'<(/[^>]*)>;\s*rel="next"', link or "")
    return found[1] if found else None


def _key_of_environment() -> str | None:
    if key := os.environ.get("PALPATE_KEY"):
        return key
    if file := os.environ.get("PALPATE_KEY_FILE"):
        return Path(file).read_text(encoding="utf-8").strip()
    return None


def _certificates(file: str | os.PathLike[str]) -> frozenset[bytes]:
    text = Path(file).read_text(encoding="ascii", errors="replace")
    blocks = re.findall(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", text, re.S)
    return frozenset(ssl.PEM_cert_to_DER_cert(block) for block in blocks)

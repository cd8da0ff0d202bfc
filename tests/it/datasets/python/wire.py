"""Requests to the service, and the list of what was wrong."""

import http.client
import json
import sys
import urllib.error
import urllib.request
from pathlib import Path

URL, DATABASE = sys.argv[1].rstrip("/"), Path(sys.argv[2])
faults: list[str] = []


def check(right, words: str) -> bool:
    if not right:
        faults.append(words)
        print(f"WRONG  {words}", flush=True)
    return bool(right)


def get(path: str, method: str = "GET", body: dict | None = None, **headers: str):
    data = None if body is None else json.dumps(body).encode()
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    if data:
        named["Content-Type"] = "application/json"
    request = urllib.request.Request(URL + path, data, named, method=method)
    try:
        with urllib.request.urlopen(request, timeout=120) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers, error.read()
    except http.client.IncompleteRead as error:
        check(False, f"{method} {path}: broke off after {len(error.partial)} bytes")
        return 0, {}, error.partial


def fetched(path: str) -> bytes:
    status, _, body = get(path)
    if status != 200:
        raise SystemExit(f"GET {path}: {status}: {body[:500].decode(errors='replace')}")
    return body


def in_pieces(path: str, piece: int = 100_000) -> bytes:
    whole, tag, length = b"", None, None
    while length is None or len(whole) < length:
        last = len(whole) + piece - 1
        status, headers, body = get(path, Range=f"bytes={len(whole)}-{last}")
        if status != 206 or not body or tag not in (None, headers["ETag"]):
            raise SystemExit(f"GET {path}, Range from {len(whole)}: {status}, {headers['ETag']}")
        tag, length = headers["ETag"], int(headers["Content-Range"].split("/")[1])
        whole += body
    return whole

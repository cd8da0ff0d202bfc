"""Attacks on a running service: its memory, another client's latency and the e-stop's meanwhile
(standard library only, Linux).

    palpate serve --rig experiments/rigs/virtual.toml --bind 127.0.0.1:8473 --no-resume --local-admin
    python3 tests/figures/attacks.py http://127.0.0.1:8473 PID

The rig must not be connected: the e-stop is pressed ten times a second. The folder needs one run that
has ended (`run-1`). With an address of `https://`, everything goes over TLS, and handshakes are one more
attack.
"""

import json
import socket
import ssl
import sys
import threading
import time
import urllib.error
import urllib.request
from urllib.parse import urlsplit

from bench import together

URL, PID = sys.argv[1], int(sys.argv[2])
AT = (urlsplit(URL).hostname, urlsplit(URL).port)
PIECE = b"a" * 65536
# The certificate is not what is measured.
TLS = ssl._create_unverified_context() if URL.startswith("https:") else None


def connect(timeout: float) -> socket.socket:
    wire = socket.create_connection(AT, timeout=timeout)
    return TLS.wrap_socket(wire) if TLS else wire


def rss_mb() -> int:
    with open(f"/proc/{PID}/status", encoding="ascii") as status:
        return int(next(line for line in status if line.startswith("VmRSS")).split()[1]) // 1024


def ask(method: str, path: str, body: dict | None = None) -> tuple[int, bytes, float]:
    """Status, body and duration, s, of a request."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(URL + path, data, {"Content-Type": "application/json"}, method=method)
    start = time.time()
    try:
        with urllib.request.urlopen(request, timeout=30, context=TLS) as answer:
            return answer.status, answer.read(), time.time() - start
    except urllib.error.HTTPError as error:
        return error.code, error.read(), time.time() - start
    except urllib.error.URLError:
        # Over TLS the refusal of a body may be lost with the connection.
        return 0, b"closed", time.time() - start


def measured(name: str, attack) -> None:
    """Runs an attack next to a reader of the status and to e-stops."""
    reads, stops, peak, over = [], [], [rss_mb()], threading.Event()
    before = peak[0]

    def repeat(seconds: float, work) -> threading.Thread:
        def loop() -> None:
            while not over.is_set():
                work()
                time.sleep(seconds)

        thread = threading.Thread(target=loop)
        thread.start()
        return thread

    threads = [
        repeat(0.02, lambda: reads.append(ask("GET", "/api/v1/status")[2])),
        repeat(0.1, lambda: stops.append(ask("POST", "/api/v1/estop")[2])),
        repeat(0.02, lambda: peak.append(rss_mb())),
    ]
    outcome = attack()
    time.sleep(0.5)
    over.set()
    for thread in threads:
        thread.join()
    reads.sort()
    p99_ms, stop_ms = 1e3 * reads[int(0.99 * len(reads)) - 1], 1e3 * max(stops)
    print(
        f"{name}: {outcome}; memory {before} -> {max(peak)} MB; status p99 {p99_ms:.0f} ms of {len(reads)}; "
        f"e-stop max {stop_ms:.1f} ms of {len(stops)}"
    )


def send_until_closed(wire: socket.socket, length: int) -> int:
    """Bytes that the service took before it closed the connection."""
    sent = 0
    try:
        while sent < length:
            wire.sendall(PIECE)
            sent += len(PIECE)
    except OSError:
        pass
    return sent


def part(name: str, length: int) -> str:
    head = f'--XX\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n'
    wire = connect(10)
    wire.sendall(
        f"POST /api/v1/imports HTTP/1.1\r\nhost: localhost\r\ncontent-type: multipart/form-data; boundary=XX\r\n"
        f"content-length: {len(head) + length}\r\n\r\n{head}".encode()
    )
    sent = send_until_closed(wire, length)
    try:
        answer = wire.recv(200)[9:12].decode()
    except OSError:
        answer = "closed"
    return f"{answer}, {sent >> 20} MB taken"


def sockets(count: int, length: int) -> str:
    wires, sent = [], 0
    for _ in range(count):
        wire = connect(5)
        wire.sendall(
            b"GET /api/v1/frames/live HTTP/1.1\r\nhost: localhost\r\nupgrade: websocket\r\nconnection: upgrade\r\n"
            b"sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        wire.recv(300)
        try:
            wire.sendall(bytes([0x01, 0xFF]) + length.to_bytes(8, "big") + bytes(4))
        except OSError:
            continue
        sent += send_until_closed(wire, length)
        wires.append(wire)
    return f"{sent >> 20} MB taken"


def streams(count: int) -> str:
    made = json.loads(ask("POST", "/api/v1/keys", {"name": f"viewer {time.time()}", "role": "viewer"})[1])
    key = made["secret"].encode()
    wires, codes = [], {}
    for _ in range(count):
        wire = connect(10)
        wire.sendall(
            b"GET /api/v1/events?since=-30 HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer " + key
            + b"\r\naccept: text/event-stream\r\n\r\n"
        )
        wires.append(wire)
    time.sleep(5)
    for wire in wires:
        code = wire.recv(15)[9:12].decode()
        codes[code] = codes.get(code, 0) + 1
    return str(codes)


def in_loops(loops: int, seconds: float, work) -> None:
    """Repeats some work in several threads; a connection that fails is not an error."""

    def loop() -> None:
        end = time.time() + seconds
        while time.time() < end:
            try:
                work()
            except OSError:
                pass

    together([(loop,)] * loops)


def wrong_keys(loops: int, seconds: float) -> str:
    count = lambda: json.loads(ask("GET", "/api/v1/status")[1])["service"]["wrong_keys"]
    before = count()

    def work() -> None:
        with connect(10) as wire:
            wire.sendall(b"GET /api/v1/status HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer x\r\n\r\n")
            wire.recv(100)

    in_loops(loops, seconds, work)
    return f"{(count() - before) / seconds:.0f} per second refused"


def handshakes(loops: int, seconds: float) -> str:
    """TLS handshakes without a request, one after the other in each loop; the others never end."""
    done, unfinished = [], []

    def work() -> None:
        wire = socket.create_connection(AT, timeout=10)
        unfinished.append(wire)
        wire.sendall(bytes([22, 3, 1, 2, 0, 1]))
        connect(10).close()
        done.append(wire)

    in_loops(loops, seconds, work)
    return f"{len(done) / seconds:.0f} per second, {len(unfinished) / seconds:.0f} unfinished"


rows = "/api/v1/datasets/run-1/rows"
measured("none, 3 s", lambda: time.sleep(3))
measured("part `who` of 1 GB", lambda: part("who", 1 << 30))
measured("part `name` of 512 MB", lambda: part("name", 512 << 20))
measured("map=2x320, 3000 rows", lambda: ask("GET", f"{rows}?map=2x320&limit=3000&columns=trial_id")[0])
measured("largest cursor", lambda: ask("GET", f"{rows}?sort=tips&cursor={2**64 - 1}")[0])
measured("2,000 filters", lambda: ask("GET", "/api/v1/trials?" + "&".join(["tips=4"] * 2000))[0])
measured("20 WebSockets, a message of 60 MB each", lambda: sockets(20, 60 << 20))
measured("note of 1.5 MB", lambda: ask("PUT", "/api/v1/lock", {"note": "x" * 1_500_000})[0])
measured("300 event streams of one viewer", lambda: streams(300))
measured("wrong keys, 60 loops, 4 s", lambda: wrong_keys(60, 4))
if TLS:
    measured("TLS handshakes, 30 loops, 4 s", lambda: handshakes(30, 4))

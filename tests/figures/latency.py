"""Latency figures of a service (standard library only).

    python3 tests/figures/latency.py PALPATE dashboards [SECONDS]  gaps between trials, with and without 20 dashboards
    python3 tests/figures/latency.py URL gaps RUN [SECONDS [OF]]  (RUN: its number) gaps between trials, with and without load
    python3 tests/figures/latency.py URL load SECONDS         200 read requests a second against the API

`gaps`: within a configuration, from the last frame of a trial to the start of the next one's motion: the
commit and everything else that is neither motion, settling nor frame. While the run is under way, for
SECONDS, each second minute is under load. Without SECONDS: a run as it was. With OF, another run's
name such as `run-1`, the load is exports of it, one after the other, instead of reads; with `dashboards` it is
20 pages of the night: live status, live frames, events, and what a page reads again and again; with `analysts` ten
people who ask one question after the other, in SQL, as groups, or for 10,000 trials with their frames.
`dashboards`: starts a service, a virtual rig at speed 20 and a long run in a temporary folder, opens 20 dashboards in
every second minute for SECONDS (480), and prints both p99 with their numbers; ends with 1 if either side has fewer than
1000 gaps or dashboards lengthen the p99 by more than 1 ms.
How long a stop takes: `stops.py`.
"""

import json
import socket
import statistics
import sys
import tempfile
import time
import urllib.error
import urllib.request
from datetime import datetime
from urllib.parse import urlsplit

sys.dont_write_bytecode = True
from bench import Bench, call, share, together  # noqa: E402

READS = ["/api/v1/status", "/api/v1/trials?limit=20&sort=-trial_id", "/api/v1/events?since=-50", "/metrics"]
PERIOD_S = 60.0
# With dashboards: the run, its speed, the fewest gaps of a side, and by how much they may lengthen the p99, ms: two quiet
# minutes differ as much.
LONG = """name = 'long'\nseed = 6\nsensor = 'sensors/ert-28.toml'\n[real_hex]\ntips = [1]\nconfigurations = 3000\n"""
SPEED, GAPS_LEAST, GAP_LIMIT_MS, GAPS_S = 20.0, 1000, 1.0, 480.0
QUESTIONS = [
    "SELECT contact_count, COUNT(*) AS n FROM trials GROUP BY contact_count",
    "SELECT depth_mm, MEDIAN(max_force_n) AS force_n FROM trials WHERE tips = 1 GROUP BY depth_mm",
    "SELECT scan_id, AVG(fvu) AS fvu, COUNT(*) AS n FROM trials GROUP BY scan_id",
    "SELECT x_mm, y_mm, force_n FROM contacts WHERE force_n > 40 LIMIT 20000",
    "/api/v1/trials/groups?group_by=tips&agg=mean(max_force_n)",
    "/api/v1/trials?contact_count=3&max_force_n__gt=10&voltages=true&limit=10000&format=arrow",
    "/api/v1/trials?limit=1000&format=csv",
    "SELECT trial_id, fvu FROM trials ORDER BY fvu DESC LIMIT 10",
    "SELECT t.trial_id, f.voltages_v FROM trials t JOIN frames f ON t.trial_id = f.trial_id WHERE t.contact_count = 6 LIMIT 500",
    "SELECT FLOOR(max_force_n) AS bin, COUNT(*) AS n FROM trials GROUP BY bin ORDER BY bin",
]


def spread(name: str, values: list[float], unit: str) -> None:
    values = sorted(values)
    if not values:
        print(f"{name}: none")
        return
    at = lambda q: share(values, q)
    print(f"{name}: n {len(values)}, p50 {at(0.5):.3f}, p99 {at(0.99):.3f}, max {values[-1]:.3f} {unit}")


def with_dashboards(palpate: str, folder: str, seconds: float) -> tuple[str, bool]:
    """Gaps between the trials of a run, without and with 20 dashboards, as words; whether enough were counted and the p99
    stays."""
    with Bench(palpate, folder, SPEED) as bench:
        bench.home()
        run = bench.queue(LONG)
        bench.begin(run)
        return verdict(measured(bench.url, str(run["scan_id"]), seconds, "dashboards"))


def verdict(found: dict[str, tuple[list[float], list[float]]]) -> tuple[str, bool]:
    """The p99 of both sides of `measured` as words; whether enough gaps were counted and it stays."""
    sides = [found[name][0] for name in ("idle", "under load")]
    counts = [len(side) for side in sides]
    if min(counts) < GAPS_LEAST:
        return f"{counts[0]} and {counts[1]} gaps: at least {GAPS_LEAST} each are needed, measure longer", False
    without, with_them = (share(side, 0.99) for side in sides)
    words = f"{without:.1f} and {with_them:.1f} ms ({counts[0]} and {counts[1]} gaps)"
    return words, with_them <= without + GAP_LIMIT_MS


def gaps(url: str, run: str, seconds: float, of: str) -> None:
    for name, (took, shares) in measured(url, run, seconds, of).items():
        spread(f"last frame to next motion, {name}", took, "ms")
        if shares:
            print(f"  share of a trial's time: mean {100 * statistics.mean(shares):.2f} %")


def measured(url: str, run: str, seconds: float, of: str) -> dict[str, tuple[list[float], list[float]]]:
    """Gaps between trials, ms, and their shares of a trial's time: idle and under load."""
    call(url, f"/api/v1/runs/{run}/trials?limit=1")  # a wrong RUN fails now, not after the load
    loaded, end = [], time.time() + seconds
    while time.time() < end:
        time.sleep(min(PERIOD_S, end - time.time()))
        if time.time() < end:
            begun = time.time()
            left = min(PERIOD_S, end - begun)
            loads = {"": load, "dashboards": lambda *at: dashboards(*at, run), "analysts": analysts}
            loads.get(of, lambda *at: exports(*at, of))(url, left)
            loaded.append((begun, time.time()))
    rows, cursor = [], ""
    while cursor is not None:
        page = call(url, f"/api/v1/runs/{run}/trials?limit=5000{cursor}")
        rows, cursor = rows + page["items"], "next" in page and f"&cursor={page['next']}" or None
    when = lambda row, key: datetime.fromisoformat(row[key].replace("Z", "+00:00")).timestamp()
    found = {"idle": ([], []), "under load": ([], [])}
    for last, row in zip(rows, rows[1:]):
        at = when(row, "started_at")
        if row["configuration"] == last["configuration"] and (not seconds or end - seconds < at < end):
            took, shares = found["under load" if any(a < at < b for a, b in loaded) else "idle"]
            gap = at - when(last, "measured_at")
            took.append(gap * 1e3)
            shares.append(gap / (when(row, "measured_at") - when(last, "measured_at")))
    return found


def analysts(url: str, seconds: float, count: int = 10) -> None:
    """One question after the other from each analyst; who is refused for now asks the next."""
    end, took, refused = time.monotonic() + seconds, [], []

    def ask(turn: int) -> None:
        while time.monotonic() < end:
            turn, question = turn + 1, QUESTIONS[turn % len(QUESTIONS)]
            is_sql = question.startswith("SELECT")
            path, body = ("/api/v1/query", {"sql": question}) if is_sql else (question, None)
            data = body and json.dumps(body).encode()
            begun = time.monotonic()
            try:
                request = urllib.request.Request(url + path, data, {"Content-Type": "application/json"})
                with urllib.request.urlopen(request, timeout=90) as answer:
                    answer.read()
                took.append(time.monotonic() - begun)
            except urllib.error.HTTPError as error:
                refused.append(error.code)
                time.sleep(0.5)

    together((ask, n) for n in range(count))
    codes = ", ".join(f"{refused.count(code)} with {code}" for code in sorted(set(refused))) or "none"
    print(f"{count} analysts: {len(took)} answers in {seconds:.0f} s, refused: {codes}")
    spread("answer", took, "s")


def exports(url: str, seconds: float, of: str) -> None:
    """One export after the other, each of other values, so that none is there already."""
    end, done = time.time() + seconds, 0
    while time.time() < end:
        wanted = {"dataset": of, "format": "csv", "slice": f"{int(time.time() * 10) % 300}:784"}
        export = call(url, "/api/v1/exports", wanted)["id"]
        while time.time() < end and call(url, f"/api/v1/exports/{export}")["state"] != "done":
            time.sleep(0.2)
        done += 1
    print(f"{done} exports of {of} in {seconds:.0f} s, the last one not finished")


def dashboards(url: str, seconds: float, run: str, count: int = 20) -> None:
    """As many pages of the night as `count`: two WebSockets each, whose messages are read, the stream of events, what is
    read once, and the repeated requests, all of them each 3 s, as the page repeats the most frequent one."""
    once = ["/vocabulary", "/published", "/status", "/runs?limit=20", f"/runs/{run}/tour", f"/sensor?run={run}", "/rig/samples?minutes=15"]
    again = [f"/runs/{run}/progress", "/twins", "/queue", "/frames/untouched", f"/runs/{run}/history?bins=120",
             f"/runs/{run}/trials?limit=1&sort=-trial_id&voltages=true&fvu__gte=0"]
    end, received, events = time.monotonic() + seconds, [], []

    def follow(path: str) -> None:
        at = urlsplit(url)
        with socket.create_connection((at.hostname, at.port), timeout=10) as wire:
            wire.sendall(f"GET {path} HTTP/1.1\r\nHost: {at.netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                         "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode())
            total = 0
            while time.monotonic() < end and (piece := wire.recv(1 << 16)):
                total += len(piece)
            received.append(total)

    def listen() -> None:
        request = urllib.request.Request(f"{url}/api/v1/events?since=-200", headers={"Accept": "text/event-stream"})
        # Without events the service sends a comment every 15 s.
        with urllib.request.urlopen(request, timeout=30) as answer:
            while time.monotonic() < end and (line := answer.readline()):
                if line.startswith(b"data:"):
                    events.append(len(line))

    def ask() -> None:
        paths = [*once, *again]
        while time.monotonic() < end:
            begun = time.monotonic()
            for path in paths:
                call(url, f"/api/v1{path}")
            paths = again
            time.sleep(max(0.0, min(begun + 3.0, end) - time.monotonic()))

    together([(follow, "/api/v1/status/live"), (follow, "/api/v1/frames/live"), (listen,), (ask,)] * count)
    print(f"{count} dashboards received {sum(received) / seconds / 1e6:.2f} MB/s over their WebSockets, {len(events)} events")


def load(url: str, seconds: float, rate: float = 200.0) -> None:
    """Several threads, each at its share of the rate."""
    took, threads, end = [], 8, time.monotonic() + seconds

    def reader(offset: int) -> None:
        due = time.monotonic() + offset / rate
        n = offset
        while due < end:
            time.sleep(max(0.0, due - time.monotonic()))
            begun = time.monotonic()
            call(url, READS[n % len(READS)])
            took.append((time.monotonic() - begun) * 1e3)
            due += threads / rate
            n += 1

    together((reader, i) for i in range(threads))
    print(f"{len(took) / seconds:.0f} requests a second")
    spread("answer", took, "ms")


def main() -> None:
    url, what, value, more, of = [*sys.argv[1:6], "", "", ""][:5]
    if what == "dashboards":
        with tempfile.TemporaryDirectory(prefix="palpate-figures-") as folder:
            words, is_met = with_dashboards(url, folder, float(value or GAPS_S))
        print(f"last frame to next motion, p99, without and with 20 dashboards: {words}")
        sys.exit(not is_met)
    {"gaps": lambda: gaps(url, value, float(more or 0), of), "load": lambda: load(url, float(value))}[what]()


if __name__ == "__main__":
    main()

"""Latency figures of a running service (standard library only).

    python3 tests/figures/latency.py URL trials RUN        gaps between trials of a run, from its records
    python3 tests/figures/latency.py URL load SECONDS      200 read requests a second against the API
    python3 tests/figures/latency.py URL estop COUNT       e-stop request to the last axis's acknowledgement

`trials`: within a configuration, from the last frame of a trial to the start of the next one's motion:
the commit and everything else that is neither motion, settling nor frame.
"""

import json
import statistics
import sys
import threading
import time
import urllib.request
from datetime import datetime

READS = ["/api/v1/status", "/api/v1/trials?limit=20&sort=-trial_id", "/api/v1/events?since=-50", "/metrics"]


def call(url: str, path: str, body: dict | None = None) -> dict | str:
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url + path, data, {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=10) as answer:
        text = answer.read().decode()
    return json.loads(text) if text.startswith(("{", "[")) else text


def spread(name: str, values: list[float], unit: str) -> None:
    values = sorted(values)
    at = lambda q: values[min(len(values) - 1, int(q * len(values)))]
    print(f"{name}: n {len(values)}, p50 {at(0.5):.3f}, p99 {at(0.99):.3f}, max {values[-1]:.3f} {unit}")


def trials(url: str, run: str) -> None:
    rows, cursor = [], 0
    while cursor is not None:
        page = call(url, f"/api/v1/runs/{run}/trials?limit=5000&cursor={cursor}")
        rows, cursor = rows + page["trials"], page["next"]
    when = lambda row, key: datetime.fromisoformat(row[key].replace("Z", "+00:00")).timestamp()
    gaps, shares = [], []
    for last, row in zip(rows, rows[1:]):
        if row["configuration"] == last["configuration"]:
            gap = when(row, "started_at") - when(last, "measured_at")
            gaps.append(gap * 1e3)
            shares.append(gap / (when(row, "measured_at") - when(last, "measured_at")))
    spread("last frame to next motion", gaps, "ms")
    print(f"share of a trial's time: mean {100 * statistics.mean(shares):.2f} %")


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

    readers = [threading.Thread(target=reader, args=(i,)) for i in range(threads)]
    for thread in readers:
        thread.start()
    for thread in readers:
        thread.join()
    print(f"{len(took) / seconds:.0f} requests a second")
    spread("answer", took, "ms")


def estop(url: str, count: int) -> None:
    rig = lambda: call(url, "/api/v1/status")["rig"]
    act = lambda action: call(url, "/api/v1/rig/actions", {"action": action, "who": "figures"})
    took = []
    for _ in range(count):
        call(url, "/api/v1/estop", {"why": "figures"})
        while (ms := rig()["estop_acknowledged_ms"]) is None or rig()["state"] != "tripped":
            time.sleep(0.02)
        took.append(ms)
        act("reset")
    spread("e-stop to the last axis's acknowledgement", took, "ms")


def main() -> None:
    url, what, value = sys.argv[1:4]
    {"trials": lambda: trials(url, value), "load": lambda: load(url, float(value)),
     "estop": lambda: estop(url, int(value))}[what]()


main()

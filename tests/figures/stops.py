"""How long a stop takes, measured where it counts: at the rig's wires (standard library only).

    python3 tests/figures/stops.py URL CONTROL estop COUNT [--key KEY] [--load] [--pid PID] [--lock DB]
    python3 tests/figures/stops.py URL CONTROL compare COUNT --pid PID --lock DB [--key KEY]
    python3 tests/figures/stops.py URL CONTROL trips COUNT
    python3 tests/figures/stops.py URL CONTROL drifts COUNT [--load] [--pid PID] [--lock DB]

`estop`: from the request's first byte to the moment at which the last axis's stop was read at the
virtual rig (its control socket at CONTROL tells), x moving at each. With --load 200 reads per second continue;
with --pid the service's process may write no file any more (a full disk: RLIMIT_FSIZE, `prlimit`); with
--lock another process holds the database's write lock.
`compare`: as `estop`, with the store idle, refusing writes and locked in turn.
`trips`: a force limit that each press exceeds; from the sample to z's acknowledged stop, as the service
measures it, and the largest force that the rig truly saw.
`drifts`: a cell drifts over its limit while a load is held, with the store in the given state.
"""

import json
import pathlib
import sqlite3
import statistics
import subprocess
import sys
import threading
import time

import latency
from bench import call, tell

SENSOR = pathlib.Path(__file__).parents[2] / "experiments/sensors/ert-28.toml"
DRIFTS = """name = 'drifts'\nseed = %d\nsensor = 's'\n[real_hex]\ntips = [2]\nconfigurations = 20\ndepths = 4
block = 20\nreference_every = 0\n[measure]\nsettle_ms = 40000.0\nsettle_max_ms = 60000.0
[policy]\nretries = 50\n"""
EXPERIMENT = """name = 'stops'\nseed = %d\nsensor = 's'\n[real_hex]\ntips = [2]\nconfigurations = 2\ndepths = 11
[measure]\nsettle_ms = 100.0\n[limits]\nforce_n = 12.0\n"""


def until(url: str, what, limit_s: float = 60.0) -> dict:
    end = time.monotonic() + limit_s
    while not what(status := call(url, "/api/v1/status")):
        if time.monotonic() > end:
            raise SystemExit(f"it does not come: {json.dumps(status['rig'], indent=1)}")
        time.sleep(0.01)
    return status


def act(url: str, action: str, **more) -> None:
    call(url, "/api/v1/rig/actions", {"action": action, "who": "figures", **more})


def homed(url: str) -> None:
    state = call(url, "/api/v1/status")["rig"]["state"]
    if state == "disconnected":
        act(url, "connect")
    elif state == "tripped":
        act(url, "reset")
    act(url, "home")
    until(url, lambda s: s["rig"]["state"] == "homed")


def estop(url: str, control: str, count: int, key: str, load: bool, pid: str, lock: str) -> None:
    took = [one_estop(url, control, n, key, load, pid, lock) for n in range(count)]
    latency.spread("request to the last axis's stop at the wire", took, "ms")
    histogram(took)


def compare(url: str, control: str, count: int, key: str, pid: str, lock: str) -> None:
    """The states of the store in turn, so that other work of the computer falls on all of them alike."""
    states = {"idle": ("", ""), "full disk": (pid, ""), "locked database": ("", lock)}
    took = {name: [] for name in states}
    for n in range(count):
        for i, (name, (full, locked)) in enumerate(states.items()):
            took[name].append(one_estop(url, control, n * len(states) + i, key, False, full, locked))
    for name, values in took.items():
        latency.spread(f"{name}: request to the last axis's stop at the wire", values, "ms")
    idle = statistics.median(took["idle"])
    for name, values in took.items():
        print(f"{name}: median {statistics.median(values) - idle:+.2f} ms against idle")


def one_estop(url: str, control: str, n: int, key: str, load: bool, pid: str, lock: str) -> float:
    """Time from a request to the last axis's stop at the wire, ms."""
    homed(url)
    act(url, "jog", axis="x", to_mm=[30.0, 540.0][n % 2])
    while not tell(control, {"cmd": "status"})["axes"][0]["moving"]:
        pass
    again = disturb(url, load, pid, lock)
    before, sent = tell(control, {"cmd": "status"})["stops"], time.time()
    call(url, "/api/v1/estop", {"why": "figures"}, key=key)
    while True:
        truth = tell(control, {"cmd": "status"})
        fresh = [r for r in truth["stop_receipts"] if r["unix_s"] >= sent]
        if {r["axis"] for r in fresh} >= {"x", "y", "z", "radial"}:
            break
    first = {}
    for receipt in fresh:
        first.setdefault(receipt["axis"], receipt["unix_s"])
    again()
    until(url, lambda s: s["rig"]["state"] == "tripped")
    assert truth["stops"] > before
    return (max(first.values()) - sent) * 1e3


def disturb(url: str, load: bool, pid: str, lock: str):
    """Puts the store into a state; what is returned takes it back."""
    if pid:
        subprocess.run(["prlimit", "--pid", pid, "--fsize=0:unlimited"], check=True)
    held = sqlite3.connect(lock, isolation_level=None) if lock else None
    if held:
        held.execute("BEGIN IMMEDIATE")
    readers = threading.Thread(target=latency.load, args=(url, 1.5)) if load else None
    if readers:
        readers.start()
        time.sleep(0.3)

    def again() -> None:
        if readers:
            readers.join()
        if held:
            held.execute("ROLLBACK")
            held.close()
        if pid:
            subprocess.run(["prlimit", "--pid", pid, "--fsize=unlimited:unlimited"], check=True)

    return again


def start(url: str, control: str, definition: str) -> str:
    """Queues, arms and starts a run, with two tips mounted; returns it once it moves."""
    body = {"file": "stops.toml", "definition": definition, "sensor": SENSOR.read_text()}
    run = call(url, "/api/v1/queue", body)["uid"]
    code = call(url, f"/api/v1/runs/{run}/arm", {})["code"]
    call(url, f"/api/v1/runs/{run}/actions", {"action": "start", "code": code})
    wants = lambda s: (s["run"] or {}).get("paused_why") == "tip_change"
    status = until(url, lambda s: wants(s) or s["rig"]["tips"] == 2)
    if wants(status):
        tell(control, {"cmd": "mount", "tips": 2})
        time.sleep(0.1)
        call(url, f"/api/v1/runs/{run}/actions", {"action": "confirm", "who": "figures"})
    return run


def drifts(url: str, control: str, count: int, load: bool, pid: str, lock: str) -> None:
    homed(url)
    run, took = start(url, control, DRIFTS % time.time()), []
    for _ in range(count):
        until(url, lambda s: s["run"]["phase"] == "settle" and s["run"]["state"] == "running")
        again = disturb(url, load, pid, lock)
        drift = {"kind": "drifting_cell", "device": "cells", "arm": 1, "n_per_s": 100.0, "for_s": 4.0}
        tell(control, {"cmd": "fault", **drift})
        status = until(url, lambda s: s["rig"]["trip"] and s["rig"]["safe_end"])
        assert status["rig"]["safe_end"]["tips"] == "raised", status["rig"]["safe_end"]
        took.append(status["rig"]["safe_end"]["sample_to_stop_ms"])
        again()
        until(url, lambda s: s["run"]["state"] == "paused")
        homed(url)
        call(url, f"/api/v1/runs/{run}/actions", {"action": "resume"})
    call(url, f"/api/v1/runs/{run}/actions", {"action": "abort"})
    latency.spread("sample to z's acknowledged stop", took, "ms")
    histogram(took)


def trips(url: str, control: str, count: int) -> None:
    took, peaks = [], []
    for n in range(count):
        homed(url)
        tell(control, {"cmd": "clear_peaks"})
        run = start(url, control, EXPERIMENT % n)
        status = until(url, lambda s: s["rig"]["trip"] or not s["run"])
        if not status["rig"]["trip"]:
            continue
        status = until(url, lambda s: s["rig"]["safe_end"] and s["run"]["state"] == "paused")
        took.append(status["rig"]["safe_end"]["sample_to_stop_ms"])
        peaks.append(tell(control, {"cmd": "status"})["peak_force_n"])
        stopping = status["rig"]["stopping"]
        call(url, f"/api/v1/runs/{run}/actions", {"action": "abort"})
        until(url, lambda s: not s["run"])
    latency.spread("sample to z's acknowledged stop", took, "ms")
    histogram(took)
    print(f"limit 12 N, margin {stopping['margin_n']} N, largest true force {max(peaks):.1f} N in {len(peaks)} trips")
    print(f"computed: {stopping['blind_ms']:.0f} process ms, {stopping['travel_mm']:.2f} mm, +{stopping['added_n']:.1f} N")


def histogram(values: list[float]) -> None:
    for low, high in [(0, 1), (1, 2), (2, 5), (5, 10), (10, 20), (20, 50), (50, 1e9)]:
        n = sum(low <= v < high for v in values)
        if n:
            print(f"  {low:>3.0f} to {high if high < 1e9 else '..'} ms  {'#' * n} {n}")


def main() -> None:
    url, control, what, count, *more = sys.argv[1:]
    option = lambda name: more[more.index(name) + 1] if name in more else ""
    if what == "estop":
        estop(url, control, int(count), option("--key"), "--load" in more, option("--pid"), option("--lock"))
    elif what == "compare":
        compare(url, control, int(count), option("--key"), option("--pid"), option("--lock"))
    elif what == "drifts":
        drifts(url, control, int(count), "--load" in more, option("--pid"), option("--lock"))
    else:
        trips(url, control, int(count))


main()

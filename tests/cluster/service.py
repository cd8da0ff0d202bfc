"""A service with a queue on a real PostgreSQL: submit, cancel, watch and gather over HTTP, and `palpate status`.

`postgresql.py` calls it after the page, whose queue, logins and store it uses (standard library only). Never: a process
that outlives it, a file outside of the home of the page.
"""

import contextlib
import json
import pathlib
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator

START_S, STEP_S, END_S, POLL_S = 60, 120, 30, 0.2
ORDER = ("--trials", "4000", "--seed", "2", "--shard-trials", "1000")
CHUNKS = 4
STORE_KEY = "store-hush-4"
PASSWORDS = ("owner-secret", "desk-secret", STORE_KEY)
# Any engine: it notes what it inherits, and ends.
ENGINE = "#!/bin/sh\nenv > {}\nexit 1\n"
DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))


class Wrong(Exception):
    """A statement that does not hold."""


def holds(statement: str, is_true: bool, found: object) -> None:
    """Fails with what was found."""
    if not is_true:
        raise Wrong(f"wrong: {statement}: {found}")


class Service:
    """A running service; ended with its `with` block, with exit code 0."""

    def __init__(self, lab: "Lab") -> None:
        """Starts it without a rig."""
        self.log = lab.home / "service.log"
        command = [lab.palpate, "serve", "--desk", "--bind", "127.0.0.1:0", "--twin-workers", "0", "--data", lab.data]
        with self.log.open("w") as log:
            self.process = subprocess.Popen(command, cwd=lab.home, env=lab.owner, stdout=log, stderr=log)
        self.data, self.url = lab.data, ""

    def __enter__(self) -> "Service":
        until = time.monotonic() + START_S
        while time.monotonic() < until and self.process.poll() is None:
            with contextlib.suppress(OSError, ValueError):
                running = json.loads((self.data / "server.json").read_text())
                if running["process"] == self.process.pid:
                    self.url = running["url"]
                    return self
            time.sleep(POLL_S)
        self.process.kill()
        self.process.wait()
        raise Wrong(f"the service did not start: {self.log.read_text()}")

    def __exit__(self, kind: type | None, *_: object) -> None:
        self.process.terminate()
        try:
            code = self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        if kind is None:
            holds("the service ends when it is told to", code == 0, code)

    def ask(self, path: str, method: str = "GET", body: object = None) -> tuple[int, dict]:
        """Status and content of an answer."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"{self.url}/api/v1{path}", data, {"content-type": "application/json"}, method=method)
        try:
            with DIRECT.open(request, timeout=STEP_S) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as error:
            return error.code, json.load(error)

    def order(self) -> dict:
        """The state of the order `bulk`."""
        return bulk(self.ask("/workers")[1])

    def until(self, what: str, test: Callable[[dict], bool]) -> dict:
        """Waits for a state of workers and orders."""
        end = time.monotonic() + STEP_S
        found = {}
        while time.monotonic() < end:
            status, found = self.ask("/workers")
            if status == 200 and test(found):
                return found
            time.sleep(POLL_S)
        raise Wrong(f"not within {STEP_S} s: {what}: {found}")


def bulk(found: dict) -> dict:
    """The order `bulk` in a state of workers and orders; empty if it has none."""
    return next((order for order in found.get("orders", ()) if order["folder"] == "bulk"), {})


class Lab:
    """What the page has made: a queue, two logins and a store."""

    def __init__(self, palpate: pathlib.Path, home: pathlib.Path, environment: dict[str, str]) -> None:
        """Names the addresses as the page does."""
        self.palpate, self.home, self.data = palpate, home, home / "palpate-data"
        engine, self.inherited = home / "engine", home / "inherited"
        engine.write_text(ENGINE.format(self.inherited))
        engine.chmod(0o755)
        store = environment | {"PALPATE_STORE": str(home / "palpate-store"), "AWS_SECRET_ACCESS_KEY": STORE_KEY}
        config = home / ".config/palpate"
        self.desk = store | {"PALPATE_QUEUE_FILE": str(config / "desk-1")}
        self.owner = store | {"PALPATE_QUEUE_FILE": str(config / "queue"), "PALPATE_QUERY": str(engine)}

    def run(self, *words: str) -> str:
        """Runs a command that must succeed, and returns what it prints."""
        done = subprocess.run([self.palpate, *words], cwd=self.home, env=self.owner, capture_output=True, text=True, timeout=STEP_S)
        holds(f"palpate {' '.join(words)}", done.returncode == 0, done.stderr)
        return done.stdout

    @contextlib.contextmanager
    def working(self) -> Iterator[None]:
        """A worker with the rights of a machine; told to end after its block."""
        process = subprocess.Popen([self.palpate, "worker", "work"], cwd=self.home, env=self.desk, stderr=subprocess.DEVNULL)
        try:
            yield
            process.terminate()
            code = process.wait(END_S)
            holds("a worker ends when it is told to", code == 0, code)
        finally:
            process.kill()  # nothing, if it has ended
            process.wait()


def check(palpate: pathlib.Path, home: pathlib.Path, environment: dict[str, str]) -> None:
    """Raises `Wrong` with the first statement that does not hold."""
    lab = Lab(palpate, home, environment)
    (lab.data / "cluster").mkdir(parents=True, exist_ok=True)
    lab.run("cluster", "sbatch", "random", *ORDER, "--folder", "palpate-data/cluster/bulk")
    with Service(lab) as service:
        submitted(lab, service)
        made(lab, service)
        gathered(lab, service)
        withheld(lab, service)
    shown = service.log.read_text()
    holds("the log has no password", not any(word in shown for word in PASSWORDS), shown)


def submitted(lab: Lab, service: Service) -> None:
    """An order is offered, submitted, cancelled and submitted again."""
    status, found = service.ask("/workers")
    holds("the queue is read", status == 200 and found["configured"] and not found["workers"], found)
    holds("the page's order is done", [(one["chunks"], one["done"]) for one in found["orders"]] == [(3, 3)], found)
    holds("the other one is offered", found["unsubmitted"] == ["bulk"], found)
    status, found = service.ask("/workers/folders/none", "POST")
    holds("a folder without an order is refused", status == 404, found)
    for counts in ((CHUNKS, 0), (0, CHUNKS)):
        status, found = service.ask("/workers/folders/bulk", "POST")
        holds("each chunk is submitted once", status == 200 and (found["added"], found["present"]) == counts, found)
    order = service.order()
    holds("the next answer shows them", order.get("waiting") == CHUNKS, order)
    status, found = service.ask(f"/workers/orders/{order['order'][:12]}", "DELETE")
    holds("an order is cancelled", status == 200 and found["removed"] == CHUNKS, found)
    order = service.order()
    holds("its chunks are missing then", (order["waiting"], order["missing"]) == (0, CHUNKS), order)
    service.ask("/workers/folders/bulk", "POST")
    service.order()  # `status` waits 2 s for what the service then has in memory
    line = lab.run("status")
    holds("`palpate status` has a line", f"0 workers; 0 of {CHUNKS} chunks done" in line, line)


def made(lab: Lab, service: Service) -> None:
    """A worker makes the order, and is shown."""
    with lab.working():
        service.until("all chunks are done, and their worker is shown",
                      lambda found: bulk(found).get("done") == CHUNKS and [one["lost"] for one in found["workers"]] == [False])
        rows = lab.run("status", "--workers")
        holds("`palpate status --workers` shows them", " ago" in rows and "bulk" in rows and "(lost)" not in rows, rows)
    order = bulk(service.until("the worker has left", lambda found: not found["workers"]))
    holds("none failed or remained", [order[one] for one in ("waiting", "running", "failed", "missing")] == [0, 0, 0, 0], order)


def gathered(lab: Lab, service: Service) -> None:
    """The results are those of one process."""
    status, found = service.ask("/workers/folders/bulk/gather", "POST")
    holds("gathering begins", status == 202 and found["into"] == "sim-random/bulk", found)
    found = service.until("it ends", lambda found: found["gather"]["state"] != "running")
    holds("it succeeds", found["gather"]["state"] == "done", found["gather"])
    lab.run("simulate", "random", *ORDER, "--out", "alone")
    same = subprocess.run(["diff", "-r", lab.data / "sim-random/bulk", lab.home / "alone"], capture_output=True, text=True)
    holds("the bytes are those of one process", same.returncode == 0, same.stdout)
    rows = lab.run("status", "--workers")
    holds("the end is shown", "gathering of bulk into sim-random/bulk: done" in rows, rows)


def withheld(lab: Lab, service: Service) -> None:
    """The query engine inherits no address and no key."""
    status, found = service.ask("/query", "POST", {"sql": "SELECT 1"})
    holds("this engine answers nothing", status >= 400, found)
    inherited = lab.inherited.read_text()
    names = [line.partition("=")[0] for line in inherited.splitlines()]
    holds("it has its own settings", "POLARS_MAX_THREADS" in names and "PATH" in names, inherited)
    holds("it has no secret", not any(name.startswith(("PALPATE_QUEUE", "PALPATE_STORE", "AWS_", "PG")) for name in names), inherited)

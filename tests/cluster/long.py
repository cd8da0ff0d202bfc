"""2,000,000 trials of Sim-Random by workers that are disturbed 100 times, against one process; their rates; the overhead of
a chunk.

    python3 tests/cluster/long.py PALPATE [--trials N] [--disturbances N] [--seed S] [--folder DIR]

PALPATE is the binary; palpate-worker is next to it, or PALPATE_WORKER names it (standard library only, Linux, PostgreSQL).
Nothing else must run. 1 to 3 take about 8 minutes on two cores, and 6 kB of disk for each trial, 12 GB by default, in
`--folder`.

1. One undisturbed process makes the order.
2. Two workers make the same order over a PostgreSQL that this starts. Each is in a network namespace without any network;
   it reaches the queue through a socket that this program forwards. Meanwhile workers and PostgreSQL are killed by SIGKILL,
   connections cut, stalled and ended, and workers told to end, at moments and in an order that `--seed` draws. Each
   disturbance waits until a further share of the chunks is done, so that the order cannot end before the last one.
3. Every chunk must be there once, with the bytes of the one process, and the queue must be empty.
4. Rates of other orders, undisturbed: one process with 1 and 2 threads, 1 worker with 1 and 2, 2 workers with one each.
5. Time from one chunk to the next, of chunks with a single trial: one process, and one worker. The difference is the overhead
   of a chunk: three requests to the queue, a line to the program, the result into the store.

The last lines are all results, as a table of `docs/figures.md`; `--trials 100000 --disturbances 0` is enough for 5. Exit
status: 0, 1 if a statement above is wrong. Without PostgreSQL it says that it was skipped, and fails if PALPATE_REQUIRE_TOOLS
is set.
"""

import argparse
import collections
import contextlib
import hashlib
import json
import os
import pathlib
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

import postgresql
from service import Wrong

TRIALS, DISTURBANCES, SEED = 2_000_000, 100, 19
SHARD_TRIALS, RATE_TRIALS, SINGLE_TRIALS = 5_000, 400_000, 2_000
TRIAL_BYTES = 6_000  # two copies of a trial, and files of killed workers
LEASE_S, END_S, PROGRESS_S, EMPTY_S = 5, 400, 300, 120
DESK = "desk"
WAYS = ("kill worker",) * 3 + ("kill PostgreSQL", "cut", "cut", "stall", "end all connections", "tell to end")
PARTIAL = "_partial-"


class Wire:
    """The only way from a worker to PostgreSQL: a socket in a folder, which is forwarded, cut and stalled."""

    def __init__(self, folder: pathlib.Path, port: int) -> None:
        """Listens in the folder, as PostgreSQL would."""
        folder.mkdir()
        self.folder, self.port = folder, port
        self.ends: set[socket.socket] = set()
        self.lock, self.flows = threading.Lock(), threading.Event()
        self.flows.set()
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.bind(str(folder / ".s.PGSQL.5432"))
        self.socket.listen(64)
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self) -> None:
        """Connects each client with the server; without a server its connection ends."""
        while True:
            near, _ = self.socket.accept()
            try:
                far = socket.create_connection(("127.0.0.1", self.port), 5)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            with self.lock:
                self.ends |= {near, far}
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self.pump, args=(source, sink), daemon=True).start()

    def pump(self, source: socket.socket, sink: socket.socket) -> None:
        """Forwards one direction until an end closes."""
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                self.flows.wait()
                sink.sendall(data)
        end((source, sink))
        with self.lock:
            self.ends -= {source, sink}

    def cut(self) -> None:
        """Ends all connections."""
        with self.lock:
            end(self.ends)

    def stall(self, seconds: float) -> None:
        """Forwards nothing for a time, as a cable that is pulled."""
        self.flows.clear()
        time.sleep(seconds)
        self.flows.set()


def end(sockets) -> None:
    """Ends connections in both directions; the threads that forward them notice."""
    for one in sockets:
        with contextlib.suppress(OSError):
            one.shutdown(socket.SHUT_RDWR)


class Lab:
    """A queue, a store, and the programs."""

    def __init__(self, palpate: pathlib.Path, server: postgresql.Server, folder: pathlib.Path) -> None:
        """Sets the queue up, with a login that has the rights of workers alone."""
        self.palpate, self.server, self.folder = palpate, server, folder
        self.worker = os.environ.get("PALPATE_WORKER", str(palpate.with_name("palpate-worker")))
        self.store = folder / "store"
        self.store.mkdir()
        self.namespace = namespace()
        self.wires: list[Wire] = []
        self.log = open(folder / "workers.log", "ab")
        until = time.monotonic() + EMPTY_S
        while not self.psql("CREATE DATABASE queue"):  # while the server starts
            if time.monotonic() > until:
                raise Wrong("PostgreSQL makes no database")
            time.sleep(0.2)
        self.ask("setup")
        self.psql(f"CREATE ROLE {DESK} LOGIN PASSWORD '{server.password}' IN ROLE palpate_worker")

    def psql(self, statement: str) -> bool:
        """Runs a statement as the administrator of the server; returns whether it succeeded."""
        environment = os.environ | {"PGPASSWORD": self.server.password, "PGCONNECT_TIMEOUT": "5"}
        server = ["-h", "127.0.0.1", "-p", str(self.server.port), "-U", "postgres", "-d", "postgres"]
        done = subprocess.run(["psql", "-X", "-q", *server, "-c", statement], env=environment,
                              stdout=subprocess.DEVNULL, stderr=self.log)
        return done.returncode == 0

    def environment(self, address: str) -> dict[str, str]:
        """That of a worker, and of the programs that it starts."""
        return os.environ | {
            "PALPATE_QUEUE": address, "PALPATE_STORE": str(self.store), "PALPATE_PROGRAM": str(self.palpate),
            "PALPATE_DATA": str(self.folder / "data"), "TMPDIR": str(self.folder)}

    def ask(self, *words: str) -> str:
        """What palpate-worker answers to the owner of the queue."""
        address = f"postgres://postgres:{self.server.password}@127.0.0.1:{self.server.port}/queue"
        done = subprocess.run([self.worker, *words], env=self.environment(address), stdout=subprocess.PIPE,
                              stderr=self.log, text=True)
        if done.returncode:
            raise Wrong(f"palpate-worker {words[0]}: exit code {done.returncode}")
        return done.stdout

    def left(self, order: dict) -> dict[str, int]:
        """What the queue still has of an order, and what it lacks."""
        state = json.loads(self.ask("status", order["id"], "--json"))["orders"][0]
        return {key: state[key] for key in ("waiting", "running", "failed", "missing") if state[key]}

    def until_empty(self, order: dict) -> None:
        """Waits for the leases of killed workers: their chunks are then found done."""
        until = time.monotonic() + EMPTY_S
        while left := self.left(order):
            if time.monotonic() > until:
                raise Wrong(f"the queue is not empty: {left}")
            time.sleep(1)

    def make(self, *words: str) -> None:
        """Runs `palpate cluster`."""
        environment = os.environ | {"PALPATE_DATA": str(self.folder / "data")}
        subprocess.run([self.palpate, "cluster", *words], env=environment, check=True, stdout=subprocess.DEVNULL,
                       stderr=self.log)

    def order(self, name: str, trials: int, seed: int, of_chunk: int = SHARD_TRIALS) -> tuple[pathlib.Path, dict]:
        """Writes an order; returns its folder and what it states."""
        folder = self.folder / name
        self.make("sbatch", "random", "--trials", str(trials), "--seed", str(seed), "--shard-trials",
                  str(of_chunk), "--folder", str(folder))
        return folder, json.loads((folder / "order.json").read_text())

    def start(self, number: int, threads: int) -> subprocess.Popen:
        """Starts a worker behind its wire."""
        while len(self.wires) <= number:
            self.wires.append(Wire(self.folder / f"wire-{len(self.wires)}", self.server.port))
        address = f"postgres://{DESK}:{self.server.password}@localhost/queue?host={self.wires[number].folder}"
        command = [*self.namespace, self.worker, "work", "--lease-s", str(LEASE_S), "--threads", str(threads)]
        return subprocess.Popen(command, env=self.environment(address), stdout=subprocess.DEVNULL, stderr=self.log)

    def done(self, order: dict) -> int:
        """Number of chunks whose result is in the store."""
        with contextlib.suppress(FileNotFoundError):
            return sum(name.endswith(".json") for name in os.listdir(self.store / order["id"] / "results"))
        return 0

    def until_done(self, order: dict, count: float) -> None:
        """Waits until chunks are done; without a new one for a time it is wrong."""
        before, since = -1, time.monotonic()
        while (now := self.done(order)) < count:
            if now > before:
                before, since = now, time.monotonic()
            if time.monotonic() - since > PROGRESS_S:
                raise Wrong(f"no chunk in {PROGRESS_S} s, {now} of {order['chunks']} done: see {self.log.name}")
            time.sleep(0.1)


def namespace() -> list[str]:
    """The command that gives a program a network namespace without a network."""
    for words in (["unshare", "--net", "--"], ["unshare", "--map-root-user", "--net", "--"]):
        with contextlib.suppress(FileNotFoundError):
            if subprocess.run([*words, "true"], stderr=subprocess.DEVNULL).returncode == 0:
                return words
    raise Wrong("no network namespaces: run as root, or allow them to users")


def told(workers: list[subprocess.Popen]) -> None:
    """Tells workers to end, and waits for them."""
    for worker in workers:
        worker.terminate()
    for worker in workers:
        if code := worker.wait(END_S):
            raise Wrong(f"a worker that was told to end has the exit code {code}")


def disturbed(lab: Lab, order: dict, count: int, chance: random.Random) -> tuple[float, collections.Counter]:
    """Makes an order while its workers are disturbed; returns the time and the number of each way."""
    began, counts, ended = time.monotonic(), collections.Counter(), []
    workers = [lab.start(number, 1) for number in range(2)]
    try:
        for number in range(count):
            lab.until_done(order, order["chunks"] * number / (count + 1))
            time.sleep(chance.uniform(0.3, 1.3))  # a worker that was just started can be told to end
            way, one = chance.choice(WAYS), chance.randrange(2)
            counts[way] += 1
            match way:
                case "kill worker":
                    workers[one].kill()
                    workers[one].wait()
                    workers[one] = lab.start(one, 1)
                case "kill PostgreSQL":
                    lab.server.process.kill()
                    lab.server.process.wait()
                    time.sleep(chance.uniform(0, 1))
                    lab.server.__enter__()
                case "cut":
                    lab.wires[one].cut()
                case "stall":
                    lab.wires[one].stall(chance.uniform(0.5, 20))
                case "end all connections":
                    lab.psql("SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                             "WHERE pid <> pg_backend_pid() AND datname = 'queue'")
                case "tell to end":
                    workers[one].terminate()
                    ended.append(workers[one])
                    workers[one] = lab.start(one, 1)
        lab.until_done(order, order["chunks"])
        seconds = time.monotonic() - began
        lab.until_empty(order)
        told([*ended, *workers])
    finally:
        for worker in [*ended, *workers]:
            worker.kill()
    return seconds, counts


def same(lab: Lab, order: dict, alone: pathlib.Path) -> int:
    """Compares the results of the store with those of one process; returns their bytes."""
    store, total = lab.store / order["id"] / "results", 0
    rows = sorted(path.name for path in (alone / "results").glob("*.json"))
    expected = sorted(rows + [name.replace(".json", ".parquet") for name in rows])
    found = sorted(name for name in os.listdir(store) if not name.startswith(PARTIAL))
    if len(rows) != order["chunks"] or found != expected:
        raise Wrong(f"{len(found)} files, {len(expected)} expected: {sorted(set(found) ^ set(expected))[:5]}")
    indexes = set()
    for name in rows:
        mine, theirs = (json.loads((folder / name).read_text()) for folder in (store, alone / "results"))
        with (store / name.replace(".json", ".parquet")).open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        if not sha256 == mine["sha256"] == theirs["sha256"]:
            raise Wrong(f"chunk {mine['index']}: sha256 {sha256}, one process made {theirs['sha256']}")
        indexes.add(mine["index"])
        total += mine["bytes"]
    if indexes != set(range(order["chunks"])):
        raise Wrong("an index is missing or doubled")
    if left := lab.left(order):
        raise Wrong(f"the queue is not empty: {left}")
    return total


def rates(lab: Lab, trials: int) -> list[tuple[str, float]]:
    """Trials per second of processes and workers."""
    found = []
    for number, (who, workers, threads) in enumerate(
            (("one process", 0, 1), ("one process", 0, 2), ("1 worker", 1, 1), ("1 worker", 1, 2), ("2 workers", 2, 1))):
        folder, order = lab.order(f"rate-{number}", trials, 100 + number)
        started = []
        if workers:
            lab.ask("submit", str(folder))
        began = time.monotonic()
        if workers:
            started = [lab.start(one, threads) for one in range(workers)]
            lab.until_done(order, order["chunks"])
        else:
            lab.make("make", str(folder), "--task", "0", "--tasks", "1", "--threads", str(threads))
        seconds = time.monotonic() - began
        told(started)
        each = " each" if workers > 1 else ""
        found.append((f"{who}, threads: {threads}{each}", trials / seconds))
        for path in (folder, lab.store / order["id"]):
            shutil.rmtree(path, ignore_errors=True)
    return found


def pace_ms(results: pathlib.Path) -> float:
    """Mean time from one chunk to the next, ms, by the times of their rows."""
    written = sorted(path.stat().st_mtime_ns for path in results.glob("*.json"))
    return (written[-1] - written[0]) / (len(written) - 1) / 1e6


def processor_ms(process: int) -> float:
    """Processor time of a process and its children until now, ms."""
    ticks = 0
    for path in pathlib.Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if path.parent.name == str(process):
                ticks += sum(map(int, fields[11:15]))  # its own time, and that of ended children
            elif fields[1] == str(process):
                ticks += sum(map(int, fields[11:13]))
    return 1000 * ticks / os.sysconf("SC_CLK_TCK")


def overhead(lab: Lab) -> list[tuple[str, str]]:
    """Times of chunks of one trial: one process and one worker, a thread each."""
    folder, _ = lab.order("single", SINGLE_TRIALS, 200, 1)
    lab.make("make", str(folder), "--task", "0", "--tasks", "1", "--threads", "1")
    alone = pace_ms(folder / "results")
    folder, order = lab.order("single-worker", SINGLE_TRIALS, 201, 1)
    lab.ask("submit", str(folder))
    before = processor_ms(lab.server.process.pid)
    worker = lab.start(0, 1)
    lab.until_done(order, order["chunks"])
    told([worker])
    queue = (processor_ms(lab.server.process.pid) - before) / order["chunks"]
    made = pace_ms(lab.store / order["id"] / "results")
    return [("a chunk of one trial, by one process and by one worker", f"{alone:.1f} ms, {made:.1f} ms"),
            ("overhead of a chunk", f"{made - alone:.1f} ms; of it processor time of PostgreSQL: {queue:.1f} ms")]


def measure(lab: Lab, options: argparse.Namespace) -> None:
    """Does what the head of this file states, and prints the figures."""
    alone, order = lab.order("alone", options.trials, options.seed)
    began = time.monotonic()
    lab.make("make", str(alone), "--task", "0", "--tasks", "1")
    once = time.monotonic() - began
    print(f"{order['chunks']} chunks by one process in {once:.0f} s", flush=True)
    lab.ask("submit", str(alone), "--attempts", "100")
    seconds, counts = disturbed(lab, order, options.disturbances, random.Random(options.seed))
    total = same(lab, order, alone)
    ways = ", ".join(f"{way} {counts[way]}" for way in dict.fromkeys(WAYS))
    print(f"the same by two workers, disturbed {options.disturbances} times, in {seconds:.0f} s: bytes equal", flush=True)
    shutil.rmtree(alone)
    shutil.rmtree(lab.store / order["id"])
    found = rates(lab, min(RATE_TRIALS, options.trials))
    (_, one), (_, two), (_, worker), _, (_, workers) = found
    what = f"{options.trials:,} trials of Sim-Random, {order['chunks']} chunks, {total / 1e9:.1f} GB"
    rows = [
        (f"{what}, by one process", f"{once:.0f} s"),
        (f"the same by two workers, each in a network namespace, with {options.disturbances} disturbances ({ways})",
         f"{seconds:.0f} s: all bytes those of the one process, none missing, none doubled"),
        *((f"trials per second: {who}", f"{rate:.0f}") for who, rate in found),
        ("1 worker with 1 thread, as a share of one process with 1 thread", f"{worker / one:.2f}"),
        ("2 workers with 1 thread each, as a share of one process with 2 threads", f"{workers / two:.2f}"),
        *overhead(lab)]
    print("\n| what | result |\n|---|---|", *(f"| {name} | {result} |" for name, result in rows), sep="\n")


def main() -> int:
    """Starts PostgreSQL, and measures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=pathlib.Path)
    parser.add_argument("--trials", type=int, default=TRIALS)
    parser.add_argument("--disturbances", type=int, default=DISTURBANCES)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path(tempfile.gettempdir()))
    options = parser.parse_args()
    found = postgresql.programs()
    free, needed = shutil.disk_usage(options.folder).free / 1e9, options.trials * TRIAL_BYTES / 1e9
    if free < needed:
        sys.exit(f"{options.folder}: {free:.1f} GB free, {needed:.1f} needed: --folder, or fewer --trials")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the server and the folder end, too
    with tempfile.TemporaryDirectory(prefix="palpate-long-", dir=options.folder, ignore_cleanup_errors=True) as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)
        with postgresql.Server(found, folder / "server") as server:
            try:
                measure(Lab(options.palpate.resolve(), server, folder), options)
            except Wrong as wrong:
                log = (folder / "workers.log").read_text(errors="replace").splitlines()
                print(*log[-30:], f"WRONG: {wrong}", sep="\n")
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

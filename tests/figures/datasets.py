"""Figures of datasets: first building, exports, joins, and an export that is killed (`questions.py`: questions and pages).

    cargo run --example fill_database -- --data DATA_DIR
    python3 tests/figures/datasets.py PALPATE_BINARY DATA_DIR [PART ..]

Needs polars. Starts the service on the filled folder and a rig that is not
there; removes DATA_DIR/datasets and DATA_DIR/exports first. Parts: export, join, kill; all
without any. Each time is the best of some repetitions with the files in the page cache, unless it is
said to be of one. Memory is the VmHWM of a service that was started for this step. Prints Markdown.
"""

import hashlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import polars as pl

from bench import call, memory_mb, until

BINARY, DATA = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
PARTS = sys.argv[3:] or ["export", "join", "kill"]
RIG = Path(__file__).parents[2] / "experiments" / "rigs" / "virtual.toml"
PORT, REPETITIONS, WAIT_S = 18180, 3, 1200
WORK = Path(tempfile.mkdtemp(prefix="palpate-figures-"))
SIM_RANDOM = 200_000


class Service:
    """`palpate serve` on the data folder."""

    url = f"http://127.0.0.1:{PORT}"

    def __init__(self):
        # Separate addresses: a bench or a test on this machine keeps its rig.
        rig = WORK / "rig.toml"
        rig.write_text(RIG.read_text().replace("127.0.0.1:50", "127.0.0.1:250"))
        self.command = [BINARY, "serve", "--data", DATA, "--bind", f"127.0.0.1:{PORT}", "--rig", rig, "--twin-workers", "0"]
        self.log = open(WORK / "serve.log", "a")
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(self.command, stdout=self.log, stderr=self.log)
        until("the service to answer", self.answers, 60, 0.02)

    def restart(self) -> None:
        self.stop()
        self.start()

    def answers(self) -> bool:
        if self.process.poll() is not None:
            raise SystemExit((WORK / "serve.log").read_text())
        try:
            return bool(self.get("/api/v1/status"))
        except OSError:
            return False

    def get(self, path: str) -> bytes:
        return self.open(path).read()

    def open(self, path: str):
        return urllib.request.urlopen(self.url + path, timeout=WAIT_S)

    def json(self, path: str, body: dict | None = None) -> dict:
        return call(self.url, path, body, WAIT_S)

    def memory_mb(self) -> float:
        return memory_mb(self.process)

    def stop(self, how=signal.SIGTERM) -> None:
        self.process.send_signal(how)
        self.process.wait(60)


def timed(work, *arguments):
    begun = time.perf_counter()
    answer = work(*arguments)
    return time.perf_counter() - begun, answer


def best(work, *arguments):
    """The least time, and the last answer."""
    took = [timed(work, *arguments) for _ in range(REPETITIONS)]
    return min(seconds for seconds, _ in took), took[-1][1]


def shown(seconds: float) -> str:
    return f"{seconds * 1e3:.1f} ms" if seconds < 1 else f"{seconds:.2f} s"


def table(title: str, columns: list[str], rows: list[list]) -> None:
    print(f"\n{title}\n\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for row in rows:
        print(f"| {' | '.join(map(str, row))} |", flush=True)


def downloaded(service: Service, path: str, name: str) -> Path:
    file = WORK / name
    with service.open(path) as answer, open(file, "wb") as out:
        shutil.copyfileobj(answer, out, 1 << 20)
    return file


# --- The parts ---------------------------------------------------------------------------------------


def first_building(service: Service, name: str) -> dict:
    service.restart()
    before = service.memory_mb()
    seconds, row = timed(service.json, "/api/v1/datasets", {"name": name})
    megabytes = row["bytes"] / 1e6
    cells = [f"{row['rows']:,}", f"{megabytes:.0f} MB", shown(seconds), f"{before:.0f} -> {service.memory_mb():.0f} MB"]
    table(f"First building of `{name}` (once)", ["rows", "file", "time", "memory"], [cells])
    return row


def export(service: Service, ours: str, frame: pl.DataFrame) -> None:
    theirs = WORK / "written.parquet"
    service.restart()
    ours_s, _ = best(downloaded, service, "/api/v1/data/run-1.parquet", "fetched.parquet")
    memory = service.memory_mb()
    polars_s, _ = best(frame.write_parquet, theirs)
    rows = [
        ["Palpate, cached Parquet to a file", shown(ours_s), f"{Path(ours).stat().st_size / 1e6:.0f} MB", f"{memory:.0f} MB"],
        ["polars, `write_parquet` of the frame in memory", shown(polars_s), f"{theirs.stat().st_size / 1e6:.0f} MB", "the frame"],
    ]
    table(f"All of `run-1` as Parquet: {ours_s / polars_s:.2f} of a polars write", ["", "best", "file", "memory"], rows)
    rows = []
    for form in ["arrow", "npz", "csv", "ndjson"]:
        requested = {"dataset": "run-1", "format": form}
        rows.append([form, *exported(service, requested)])
    table("Exports of all of `run-1` (once each)", ["format", "time", "file", "rows/s", "memory"], rows)


def finished(service: Service, requested: str) -> dict:
    def look():
        row = service.json(f"/api/v1/exports/{requested}")
        if row["state"] == "failed":
            raise SystemExit(f"{requested}: {row['error']}")
        return row if row["state"] == "done" else None

    return until(f"{requested} to be done", look, WAIT_S, 0.1)


def exported(service: Service, requested: dict) -> list[str]:
    service.restart()
    before = service.memory_mb()
    ask = lambda: finished(service, service.json("/api/v1/exports", requested)["id"])
    seconds, row = timed(ask)
    rows = service.json(f"/api/v1/datasets/{row['dataset']}")["rows"]
    memory = f"{before:.0f} -> {service.memory_mb():.0f} MB"
    return [shown(seconds), f"{row['bytes'] / 1e6:,.0f} MB", f"{rows / seconds:,.0f}", memory]


def join(service: Service) -> None:
    folder = DATA / "sim-random" / "seed-1"
    if not (folder / "_manifest.json").exists():
        command = [BINARY, "simulate", "random", "--trials", str(SIM_RANDOM), "--seed", "1", "--out", folder]
        seconds, _ = timed(lambda: subprocess.run(command, check=True, stdout=service.log, stderr=service.log))
        print(f"\n{SIM_RANDOM:,} Sim-Random trials made in {shown(seconds)}")
    first_building(service, "s2s-recon")
    rows = [
        [words, *exported(service, {"dataset": "s2s-recon", "format": form, "map": "20x60", **more})]
        for words, form, more in [
            ("Parquet", "parquet", {}),
            ("NPZ of frame, map and split", "npz", {"columns": ["sim_voltages_v", "split"]}),
        ]
    ]
    table("`s2s-recon` with a 32 x 32 map (`map=20x60`), once each", ["", "time", "file", "rows/s", "memory"], rows)


def kill(service: Service) -> None:
    requested = {"dataset": "run-1", "format": "csv", "columns": ["trial_id", "contacts", "voltages_v"]}
    clear_exports()
    ask = service.json("/api/v1/exports", requested)["id"]

    def half():
        row = service.json(f"/api/v1/exports/{ask}")
        if row["state"] == "done":
            raise SystemExit("the export was done before it could be killed")
        return row["rows_total"] and row["rows_done"] * 2 > row["rows_total"] and row

    row = until("half of the export", half, WAIT_S, 0.02)
    service.stop(signal.SIGKILL)
    left = [file.name for file in (DATA / "exports").iterdir()]
    service.start()
    resumed = finished(service, ask)
    bytes_ = service.get(f"/api/v1/exports/{ask}/file")
    right = hashlib.sha256(bytes_).hexdigest() == resumed["sha256"]
    clear_exports()
    again = finished(service, service.json("/api/v1/exports", requested)["id"])
    same = again["sha256"] == resumed["sha256"] and right
    cells = [f"{row['rows_done']:,} of {row['rows_total']:,}", ", ".join(left), resumed["sha256"][:16], again["sha256"][:16], "yes" if same else "NO"]
    table("CSV export, killed with SIGKILL and resumed", ["killed at row", "left behind", "sha256", "undisturbed", "the same"], [cells])


def clear_exports() -> None:
    shutil.rmtree(DATA / "exports", ignore_errors=True)


def main() -> None:
    clear_exports()
    shutil.rmtree(DATA / "datasets", ignore_errors=True)
    print(f"polars {pl.__version__}, best of {REPETITIONS}")
    service = Service()
    try:
        row = first_building(service, "run-1")
        if "export" in PARTS:
            ours = str(downloaded(service, row["url"], "run-1.parquet"))
            export(service, ours, pl.read_parquet(ours))
        if "join" in PARTS:
            join(service)
        if "kill" in PARTS:
            kill(service)
    finally:
        service.stop()
        shutil.rmtree(WORK, ignore_errors=True)


main()

"""Ten questions of a lab, side by side at two sizes: Palpate over HTTP, DuckDB, polars and Datasette.

    cargo build && cargo build --manifest-path query/Cargo.toml
    python3 tests/figures/questions.py PALPATE FOLDER [--copies 0,35] [--measured-copies] [--repeat 3] [--profile dev]

FOLDER holds a data folder for each size, `copies-0` (93,674 trials) and `copies-35` (3,372,264), which is filled
first if it is missing. They take about 1.4 and 37 GB, a third of it for the datasets; with `--measured-copies`, by
which copies have no frames of their twins, 1.4 and 21 GB. The service keeps 2 GB free. Needs polars and duckdb;
Datasette is installed into this Python if it is missing, and if that fails, a line states it and the others are asked.

For each size it starts the service, makes the dataset of each run, and prints the table of
`python/benchmarks/ask.py`. Then it asks for pages of trials, by conditions with an index and without, over one
connection, and reads them into one piece of memory, as `curl -o /dev/null` does: `read()` of Python's http.client alone
takes more processor time for 66 MB than the service does for many pages. It prints the time until the last byte, the
processor time of the service and its first touches of memory (minor page faults) for a request, and the largest memory
of the service. Ends with status 1 if rows differ between the tools.
"""

import argparse
import http.client
import importlib.util
import os
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

from bench import Bench, memory_mb

HERE = Path(__file__).resolve()
ROOT = HERE.parents[2]
ASK = ROOT / "python" / "benchmarks" / "ask.py"
DATASETTE = "datasette==0.65.5"
PAGE_REPEATS, BUILD_S = 20, 1200
# All bodies are read into it.
PIECE = memoryview(bytearray(1 << 18))
# Space on the disk, GB: the first run with its dataset, what stays free, and a copy with and without the frames of twins.
FIRST_GB, FREE_GB, COPY_GB = 1.4, 3.0, {False: 1.02, True: 0.55}
PAGES = [
    ("100 trials, JSON", "limit=100"),
    ("100 trials, both frames, Arrow", "limit=100&voltages=true&format=arrow"),
    ("100 trials, three contacts and over 10 N", "limit=100&contact_count=3&max_force_n__gt=10"),
    ("100 trials, FVU over 0.02", "limit=100&fvu__gt=0.02"),
    ("100 trials, newest first, one tip and over 20 N", "limit=100&tips=1&max_force_n__gt=20&sort=-trial_id"),
    ("no trial: FVU under 0.0001", "limit=100&fvu__lt=0.0001"),
    ("no trial: settled in 1 ms", "limit=100&settle_ms__lt=1"),
    ("no trial: measured in the future", "limit=100&measured_at__gt=2999-01-01T00:00:00Z"),
    ("no trial: a flag", "limit=100&flagged=true"),
    ("10,000 trials, both frames, three contacts and over 10 N, Arrow",
     "limit=10000&contact_count=3&max_force_n__gt=10&voltages=true&format=arrow"),
]  # fmt: skip


def has_datasette():
    """Whether Datasette can be asked; it is installed if it is missing."""
    if importlib.util.find_spec("datasette"):
        return True
    install = [sys.executable, "-m", "pip", "install", "--quiet", DATASETTE]
    done = subprocess.run(install, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        why = (done.stderr.strip().splitlines() or ["no reason was stated"])[-1]
        print(f"**Without Datasette**: `pip install {DATASETTE}` failed: {why}", flush=True)
    return done.returncode == 0


def filled(folder, copies, arguments):
    """The data folder with this number of copies of the first run; filled if it is missing."""
    measured = arguments.measured_copies and copies > 0
    data = folder / f"copies-{copies}{'-measured' if measured else ''}"
    if not (data / "palpate.db").exists():
        needed, free = FIRST_GB + FREE_GB + copies * COPY_GB[measured], shutil.disk_usage(folder).free / 1e9
        if free < needed:
            raise SystemExit(f"{data}: needs {needed:.0f} GB, {free:.0f} GB are free: fewer --copies, or --measured-copies")
        began = time.monotonic()
        partial = data.with_suffix(".partial")
        shutil.rmtree(partial, ignore_errors=True)
        command = ["cargo", "run", "--profile", arguments.profile, "--example", "fill_database", "--"]
        command += ["--data", partial, "--copies", str(copies)] + ["--measured-copies"] * measured
        subprocess.run(command, check=True, cwd=ROOT)
        partial.rename(data)
        print(f"{data} filled in {time.monotonic() - began:.0f} s", flush=True)
    return data


def used(process):
    """Processor time, ms, and first touches of memory of a process until now."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return 1000 * (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), int(fields[7])


def page(connection, parameters):
    """Requests a page; returns the time until its last byte, ms, and its length."""
    length, began = 0, time.perf_counter()
    connection.request("GET", f"/api/v1/trials?{parameters}")
    answer = connection.getresponse()
    if answer.status != 200:
        raise SystemExit(f"{parameters}: {answer.status}: {answer.read().decode()}")
    while count := answer.readinto(PIECE):
        length += count
    return 1000 * (time.perf_counter() - began), length


def pages(bench):
    """Prints a line for each list of trials: the first request, then the median of some further ones."""
    print("| list of trials | first | median | processor time | page faults | bytes |\n|---|---|---|---|---|---|")
    connection = http.client.HTTPConnection(urlsplit(bench.url).netloc, timeout=60)
    for words, parameters in PAGES:
        first, length = page(connection, parameters)
        ms, faults = used(bench.service)
        times = [page(connection, parameters)[0] for _ in range(PAGE_REPEATS)]
        ms, faults = ((after - before) / PAGE_REPEATS for before, after in zip((ms, faults), used(bench.service)))
        print(f"| {words} | {first:.1f} ms | {statistics.median(times):.1f} ms | {ms:.1f} ms | {faults:.0f} "
              f"| {length:,} |", flush=True)  # fmt: skip
    connection.close()


def measured(bench, data, runs, arguments, datasette):
    """Prints the tables of a size; returns whether all tools have the same rows."""
    began = time.monotonic()
    for run in range(1, runs + 1):
        bench.api("/datasets", {"name": f"run-{run}"}, seconds=BUILD_S)
    print(f"\n{runs} datasets made or found in {time.monotonic() - began:.1f} s", flush=True)
    command = [sys.executable, ASK, "--url", bench.url, "--runs", str(runs), "--data", data]
    command += ["--datasette"] if datasette else []
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "python" / "src"), "NO_PROXY": "*"}
    # The engine may have to be built, and the columns of the datasets be written.
    first = [*command, "--repeat", "1", "--only", "1"]
    subprocess.run(first, check=True, env=environment, stdout=subprocess.DEVNULL)
    all_questions = [*command, "--repeat", str(arguments.repeat)]
    table = subprocess.run(all_questions, check=True, env=environment, stdout=subprocess.PIPE, text=True).stdout
    print(table)
    pages(bench)
    print(f"\nThe service held {memory_mb(bench.service):.0f} MB at most.", flush=True)
    return "(other rows)" not in table


def main():
    """Measures each size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("palpate", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--copies", default="0,35")
    parser.add_argument("--measured-copies", action="store_true", help="copies without the frames of their twins")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--profile", default="dev", help="profile of cargo for fill_database")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    same, datasette = True, has_datasette()
    for copies in map(int, arguments.copies.split(",")):
        data = filled(folder, copies, arguments)
        # Without twins of this version's model: those that are stored are asked about.
        with Bench(arguments.palpate, data, serve=("--twin-workers", "0")) as bench:
            same &= measured(bench, data, copies + 1, arguments, datasette)
    sys.exit(not same)


main()

"""Ten questions of a lab, side by side at two sizes: Palpate over HTTP, DuckDB, polars and, if asked for, Datasette.

    cargo build && cargo build --manifest-path query/Cargo.toml
    python3 tests/figures/questions.py PALPATE FOLDER [--datasette] [--copies 0,35] [--repeat 3] [--profile dev]

FOLDER holds a data folder for each size, `copies-0` (93,674 trials) and `copies-35` (3,372,264), which is filled
first if it is missing. They take about 1 and 36 GB, half of it at the end, and many minutes. Needs polars and
duckdb; `--datasette` also asks Datasette, which is installed into this Python if it is missing.

For each size it starts the service, makes the dataset of each run, and prints the table of
`python/benchmarks/ask.py`. Then it asks for pages of trials, by conditions with an index and without, and prints the
largest memory of the service. Ends with status 1 if rows differ between the tools.
"""

import argparse
import importlib.util
import os
import shutil
import statistics
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

from bench import Bench

HERE = Path(__file__).resolve()
ROOT = HERE.parents[2]
ASK = ROOT / "python" / "benchmarks" / "ask.py"
DATASETTE = "datasette==0.65.5"
PAGE_REPEATS, BUILD_S = 20, 1200
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


def filled(folder, copies, profile):
    """The data folder with this number of copies of the first run; filled if it is missing."""
    data = folder / f"copies-{copies}"
    if not (data / "palpate.db").exists():
        began = time.monotonic()
        partial = folder / f"copies-{copies}.partial"
        shutil.rmtree(partial, ignore_errors=True)
        command = ["cargo", "run", "--profile", profile, "--example", "fill_database", "--"]
        subprocess.run([*command, "--data", partial, "--copies", str(copies)], check=True, cwd=ROOT)
        partial.rename(data)
        print(f"{data} filled in {time.monotonic() - began:.0f} s", flush=True)
    return data


def page(bench, parameters):
    """Time of a page, ms: the median of some requests after the first."""
    times = []
    for _ in range(PAGE_REPEATS + 1):
        began = time.perf_counter()
        with urllib.request.urlopen(f"{bench.url}/api/v1/trials?{parameters}", timeout=60) as answer:
            length = len(answer.read())
        times.append(1000 * (time.perf_counter() - began))
    return times[0], statistics.median(times[1:]), length


def memory_mb(process):
    """Largest memory of a process until now."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) // 1000


def measured(bench, data, runs, arguments):
    """Prints the tables of a size; returns whether all tools have the same rows."""
    began = time.monotonic()
    for run in range(1, runs + 1):
        bench.api("/datasets", {"name": f"run-{run}"}, seconds=BUILD_S)
    print(f"\n{runs} datasets made or found in {time.monotonic() - began:.0f} s", flush=True)
    command = [sys.executable, ASK, "--url", bench.url, "--runs", str(runs), "--data", data]
    command += ["--datasette"] if arguments.datasette else []
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "python" / "src"), "NO_PROXY": "*"}
    # The engine may have to be built, and the columns of the datasets be written.
    first = [*command, "--repeat", "1", "--only", "1"]
    subprocess.run(first, check=True, env=environment, stdout=subprocess.DEVNULL)
    all_questions = [*command, "--repeat", str(arguments.repeat)]
    table = subprocess.run(all_questions, check=True, env=environment, stdout=subprocess.PIPE, text=True).stdout
    print(table)
    print("| list of trials | first | median | bytes |\n|---|---|---|---|")
    for words, parameters in PAGES:
        first, median, length = page(bench, parameters)
        print(f"| {words} | {first:.1f} ms | {median:.1f} ms | {length:,} |", flush=True)
    print(f"\nThe service held {memory_mb(bench.service)} MB at most.", flush=True)
    return "(other rows)" not in table


def main():
    """Measures each size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("palpate", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--datasette", action="store_true")
    parser.add_argument("--copies", default="0,35")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--profile", default="dev", help="profile of cargo for fill_database")
    arguments = parser.parse_args()
    if arguments.datasette and not importlib.util.find_spec("datasette"):
        subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", DATASETTE], check=True)
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    same = True
    for copies in map(int, arguments.copies.split(",")):
        data = filled(folder, copies, arguments.profile)
        # Without twins of this version's model: those that are stored are asked about.
        with Bench(arguments.palpate, data, serve=("--twin-workers", "0")) as bench:
            same &= measured(bench, data, copies + 1, arguments)
    sys.exit(not same)


main()

"""Timing of a run while ten analysts ask, and how soon its Parquet file is there: from a filled data folder to figures.

    cargo build && cargo build --manifest-path query/Cargo.toml
    python3 tests/figures/analysts.py PALPATE FOLDER [--seconds 720] [--speed 10]

FOLDER: a data folder whose trials are asked about, such as `copies-0` of `questions.py` (93,674 trials; a run adds to
it). Starts the service with a virtual rig, makes the dataset of each run that has none, homes the rig, begins
`real-hex-4`, and measures as `latency.py URL gaps RUN SECONDS analysts` does: from the last frame of a trial to the
next motion, in alternating minutes with and without ten people who ask. Then it aborts the run and prints the time
until its dataset is there. Needs the standard library alone. Ends with status 1 if a kind of minutes has fewer than
1,000 gaps, or if the analysts lengthen the p99 by more than two quiet minutes differ (`latency.py`).
"""

import argparse
import sys
import time
import urllib.error

import latency
from bench import WHO, Bench, until

MADE_S = 300


def made(bench, run):
    """The dataset of a run, if it is there."""
    try:
        return bench.api(f"/datasets/run-{run['scan_id']}")
    except urllib.error.HTTPError as error:
        if error.code != 404:
            raise
        return None


def main():
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("palpate")
    parser.add_argument("folder")
    parser.add_argument("--seconds", type=float, default=720.0)
    parser.add_argument("--speed", type=float, default=10.0)
    arguments = parser.parse_args()
    with Bench(arguments.palpate, arguments.folder, arguments.speed) as bench:
        for run in bench.api("/runs?limit=1000")["items"]:
            if run["state"] == "ended":
                bench.api("/datasets", {"name": f"run-{run['scan_id']}"})
        # The columns of the datasets are written, and the engine is in memory.
        bench.api("/query", {"sql": "SELECT COUNT(*) AS n FROM trials"})
        bench.home()
        run = bench.carried("real-hex-4")
        bench.begin(run)
        found = latency.measured(bench.url, run["uid"], arguments.seconds, "analysts")
        for name, (took, _) in found.items():
            latency.spread(f"last frame to next motion, {name}", took, "ms")
        bench.api(f"/runs/{run['uid']}/actions", {"action": "abort", "who": WHO})
        bench.ended(run, MADE_S)
        began = time.monotonic()
        dataset = until("the dataset of the run", lambda: made(bench, run), MADE_S)
        print(f"Parquet of {dataset['rows']} trials: {time.monotonic() - began:.1f} s after the end of the run")
    words, is_met = latency.verdict(found)
    print(f"last frame to next motion, p99, without and with ten analysts: {words}")
    sys.exit(not is_met)


main()

"""A data folder as after the paper's campaign: 198,000 trials with frames and twins, and the events of its week.

    cargo build --release --example fill_database
    python3 tests/figures/week.py FILL_DATABASE FOLDER [--trials N]

Runs FILL_DATABASE, the example that was built, on an empty FOLDER, then adds the start and the end of the run and an
event each half minute: references, estimates, failures, skips, and waits for a person. Such an event is what a
campaign stores; their number is that of a restless week. Needs the standard library alone, and 2 GB.
"""

import argparse
import json
import pathlib
import sqlite3
import subprocess
from datetime import datetime, timedelta, timezone

TRIALS, DEPTHS = 198_000, 11
# Start of the first trial of fill_database, and from one trial to the next.
BEGUN, TRIAL_S = datetime(2026, 1, 1, tzinfo=timezone.utc), 2.7
EVENT_S = 30
# In events: between two estimates, failures, skips, and changes of tips.
ESTIMATES, FAILURES, SKIPS, CHANGES = 20, 50, 400, 2880


def written(at):
    """A time as the database has it."""
    return at.strftime("%Y-%m-%dT%H:%M:%S.") + f"{at.microsecond // 1000:03d}Z"


def events(trials):
    """Each event of the run: seconds from its start, kind, data."""
    count = int(trials * TRIAL_S / EVENT_S)
    yield 0.0, "state", {"state": "running", "requested": "running", "why": None}
    for n in range(1, count):
        at_s, trial = n * EVENT_S, int(n * EVENT_S / TRIAL_S)
        configuration, rest_s = trial // DEPTHS, (trials - trial) * TRIAL_S
        if n % CHANGES == 0:
            words = "mount tips"
            yield at_s, "wanted", {"why": "tip_change", "wanted": {"tips": 1 + n // CHANGES % 6}, "words": words}
            yield at_s, "state", {"state": "paused", "requested": None, "why": "tip_change"}
            yield at_s + EVENT_S / 2, "state", {"state": "running", "requested": None, "why": None}
        elif n % SKIPS == 0:
            yield at_s, "skipped", {"configuration": configuration, "reason": "the frame has 3 stuck channels"}
        elif n % FAILURES == 0:
            key = {"configuration": configuration, "depth_index": trial % DEPTHS}
            yield at_s, "attempt_failed", {"trial": key, "attempt": 1, "reason": "the forces did not settle in 6 s"}
        elif n % ESTIMATES == 0:
            yield at_s, "estimate", {"remaining_s": rest_s, "low_s": 0.97 * rest_s, "high_s": 1.05 * rest_s,
                                     "trials_stored": trial}
        else:
            yield at_s, "reference", {"before": configuration}
    yield trials * TRIAL_S, "ended", {"exit_status": "success", "reason": "every planned trial is stored"}


def fill(program, folder, trials=TRIALS):
    """Fills an empty folder; one that was filled before is kept."""
    file = pathlib.Path(folder) / "palpate.db"
    if not file.exists():
        subprocess.run([program, "--data", folder, "--trials", str(trials)], check=True)
    with sqlite3.connect(file) as database:
        if database.execute("SELECT count(*) FROM events WHERE run = 1").fetchone()[0]:
            return
        at = lambda seconds: written(BEGUN + timedelta(seconds=seconds))
        rows = [(at(seconds), kind, json.dumps(data)) for seconds, kind, data in events(trials)]
        database.executemany("INSERT INTO events (run, at, kind, data) VALUES (1, ?, ?, ?)", rows)
        times = at(0), at(trials * TRIAL_S)
        database.execute("UPDATE runs SET started_at = ?, ended_at = ? WHERE scan_id = 1", times)
    database.close()
    print(f"{trials:,} trials and {len(rows):,} events in {file}", flush=True)


def main():
    """Fills a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--trials", type=int, default=TRIALS)
    args = parser.parse_args()
    fill(args.program.resolve(), args.folder, args.trials)


if __name__ == "__main__":
    main()

"""Nets of Table IV that two workers train over PostgreSQL and a store have the bytes of those of one process, and make it.

`postgresql.py` calls it after the page, whose queue, logins, store and Sim-Random it uses (standard library only). Each worker
has an empty data folder: its dataset comes from the store. The nets learn almost nothing. Never: a process that outlives it.
"""

import contextlib
import pathlib
import re
import subprocess
from collections.abc import Iterator

from service import STEP_S, Lab, holds

EXTENT = ("--epochs", "1", "--rows", "40", "--scored", "20")
# Twelve Recon-Nets, and two regressions each.
NETS, DESKS = 36, 2
PLACES = ("nets", "alone")


def check(palpate: pathlib.Path, home: pathlib.Path, environment: dict[str, str]) -> None:
    """Raises `Wrong` with the first statement that does not hold."""
    lab = Lab(palpate, home, environment)
    lab.owner["PALPATE_DATA"] = str(lab.data)
    for place in PLACES:
        lab.run("cluster", "sbatch", "table", "maps", *EXTENT, "--folder", place)
    lab.run("worker", "submit", "nets")
    stored = [path.name for path in (home / "palpate-store/inputs").iterdir()]
    datasets = [path.name for path in (home / "nets/inputs").iterdir()]
    holds("the store has the dataset once", len(stored) == 1 and stored == datasets, (stored, datasets))
    trained(lab)
    lab.run("worker", "fetch", "nets", "nets")
    nets = [{path.name: path.read_bytes() for path in (home / place / "results").glob("*.net")} for place in PLACES]
    holds(f"{NETS} nets have the bytes of one process", len(nets[0]) == NETS and nets[0] == nets[1], [sorted(one) for one in nets])
    jobs = lab.run("job", "list", "--json")
    # Equal bytes make equal tables: `tests/it/evaluate/chunks.rs`.
    lab.run("cluster", "gather", "nets", "--out", "nets-trained")
    lab.run("evaluate", "maps", *EXTENT, "--trained", "nets-trained", "--out", "nets-table")
    holds("the service has trained and scored nothing", lab.run("job", "list", "--json") == jobs, jobs)
    holds("there is a table of them", any((home / "nets-table").iterdir()), "no file")


def trained(lab: Lab) -> None:
    """Two workers train the nets of an order, and meanwhile one process the same nets."""
    desks = [lab.home / f"desk-{number}" for number in range(DESKS)]
    with contextlib.ExitStack() as ended:
        workers = [ended.enter_context(working(lab, desk)) for desk in desks]
        lab.run("cluster", "make", "alone", "--task", "0", "--tasks", "1", "--data", "alone-data")
        for worker in workers:
            code = worker.wait(STEP_S)
            holds("a worker ends when all nets are trained", code == 0, code)
    logs = [(desk / "log").read_text() for desk in desks]
    made = [int(found[-1]) if (found := re.findall(r"made=(\d+)", log)) else 0 for log in logs]
    holds("both workers have trained nets, each once", min(made) > 0 and sum(made) == NETS, (made, logs))


@contextlib.contextmanager
def working(lab: Lab, desk: pathlib.Path) -> Iterator[subprocess.Popen]:
    """A worker with the rights of a machine, which shares no folder but the store; killed after its block."""
    desk.mkdir()
    variables = lab.desk | {"PALPATE_DATA": str(desk / "data"), "TMPDIR": str(desk)}
    command = [lab.palpate, "worker", "work", "--until-idle", "--threads", "1"]
    with (desk / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=desk, env=variables, stderr=log)
    try:
        yield process
    finally:
        process.kill()  # nothing, if it has ended
        process.wait()

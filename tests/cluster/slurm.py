"""Sim-Random as an array job of a real Slurm, whose tasks end at random, against one process (standard library only).

    python3 tests/cluster/slurm.py PALPATE [--seed S] [--rates TRIALS]

PALPATE is the binary. Starts Slurm on this machine (`one_node.py`), then does what `docs/how-to/cluster.md` tells a
laboratory: writes an order, submits its job, submits what is missing until nothing is, gathers. Meanwhile tasks are
cancelled by scancel and killed by SIGKILL at moments that `--seed` draws. Every file that `cluster gather` writes
must equal that of `simulate random` byte for byte, and the folder of the order must hold nothing but its results.

`--rates`: instead measures the rate of one process with 1 and 2 threads, and of 1 and 2 tasks at a time with a
thread each, for a number of trials, on a machine that does nothing else.

Exit status: 0, 1 if a statement above is wrong. Without Slurm the line `left out` and 0; with PALPATE_REQUIRE_TOOLS=1
in the environment a failure.
"""

import argparse
import collections
import contextlib
import dataclasses
import os
import pathlib
import random
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time

import one_node
from service import Wrong

TRIALS, SHARD_TRIALS, SEED, TASKS = 24_000, 1_000, 7, 4
CHUNKS = TRIALS // SHARD_TRIALS
CALM_ROUND = 4  # from here on no task is ended, so that the order completes
LIMIT_S = 300
FIRST_DELAY_S, DELAY_S = 0.4, 1.0  # from the moment at which a process is seen to its end; a task takes longer
WAYS = ("SIGKILL", "scancel")
RATE_CHUNKS = 40


@dataclasses.dataclass
class Lab:
    """A program, a folder, and Slurm: what every step needs."""

    palpate: str
    folder: pathlib.Path
    slurm: one_node.Slurm
    chance: random.Random

    def run(self, *command: str | pathlib.Path, status: int = 0) -> str:
        """Runs a command in the folder; returns what it printed. Another exit status is `Wrong`."""
        typed = " ".join(map(str, command)).replace(self.palpate, "palpate").replace(f"{self.folder}/", "")
        done = subprocess.run([str(word) for word in command], cwd=self.folder, env=self.slurm.environment,
                              stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=LIMIT_S)
        if done.returncode != status:
            raise Wrong(f"{typed}: exit status {done.returncode}, not {status}\n{done.stdout}{done.stderr}")
        return done.stdout + done.stderr

    def simulate(self, out: str, trials: int, shard_trials: int, threads: int) -> None:
        """One process: the reference."""
        self.run(self.palpate, "simulate", "random", *self.size(trials, shard_trials), "--threads", str(threads),
                 "--out", out)

    def order(self, folder: str, trials: int, shard_trials: int, tasks: int) -> pathlib.Path:
        """Writes an order with its job."""
        self.run(self.palpate, "cluster", "sbatch", "random", *self.size(trials, shard_trials), "--tasks", str(tasks),
                 "--folder", folder)
        return self.folder / folder

    @staticmethod
    def size(trials: int, shard_trials: int) -> list[str]:
        """The options that both forms have."""
        return ["--trials", str(trials), "--shard-trials", str(shard_trials), "--seed", str(SEED)]

    def submit(self, command: str) -> None:
        """Submits a job; the command is one that a document or a message states."""
        print(f"  {command.replace(f'{self.folder}/', '')}", flush=True)
        printed = self.run(*command.split())
        if not re.search(r"Submitted batch job \d+", printed):
            raise Wrong(f"{command}: {printed}")

    def queued(self) -> bool:
        """Whether a task waits or runs."""
        return bool(self.run("squeue", "--noheader", "--me", "--format=%i"))

    def wait(self, each: collections.abc.Callable[[], None] = lambda: None, pause_s: float = 0.1) -> None:
        """Waits until the queue is empty."""
        until = time.monotonic() + LIMIT_S
        while self.queued():
            each()
            time.sleep(pause_s)
            if time.monotonic() > until:
                raise Wrong(f"a task is still in the queue after {LIMIT_S} s")


@dataclasses.dataclass
class Maker:
    """A process that makes chunks: the task it belongs to, when it ends, and how."""

    pid: int
    task: str
    at: float
    fate: str


class Chaos:
    """Ends the processes that make chunks as tasks of this Slurm, at random."""

    def __init__(self, lab: Lab) -> None:
        """Before the first submission."""
        self.lab = lab
        self.known: dict[int, Maker] = {}
        self.ended: collections.Counter[str] = collections.Counter()
        self.round = 0

    def step(self) -> None:
        """Decides on the processes that are new, and ends those whose moment has come."""
        for pid, task in self.makers():
            if pid not in self.known:
                delay_s = FIRST_DELAY_S if len(self.known) < len(WAYS) else DELAY_S
                at = time.monotonic() + self.lab.chance.uniform(0, delay_s)
                self.known[pid] = Maker(pid, task, at, self.fate())
        for maker in self.known.values():
            if maker.fate != "left" and time.monotonic() >= maker.at:
                self.end(maker)

    def fate(self) -> str:
        """The first two processes are ended each in one way, the others at random."""
        if len(self.known) < len(WAYS):
            return WAYS[len(self.known)]
        return self.lab.chance.choice([*WAYS, "left"]) if self.round < CALM_ROUND else "left"

    def end(self, maker: Maker) -> None:
        """Ends a process, or its task, if it has not ended by itself."""
        fate, maker.fate = maker.fate, "left"
        if maker.pid not in dict(self.makers()):
            return
        if fate == "scancel":
            self.lab.run("scancel", maker.task)
        else:
            with contextlib.suppress(ProcessLookupError):
                os.kill(maker.pid, signal.SIGKILL)
        self.ended[fate] += 1

    def makers(self) -> list[tuple[int, str]]:
        """The processes that make chunks as tasks of this Slurm, with these tasks as it names them."""
        found = []
        for process in pathlib.Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                words = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
                if {"cluster", "make"} <= set(words):
                    pairs = (process / "environ").read_bytes().decode(errors="replace").split("\0")
                    names = dict(pair.partition("=")[::2] for pair in pairs)
                    if names.get("SLURM_CONF") == str(self.lab.slurm.configuration):
                        task = f"{names['SLURM_ARRAY_JOB_ID']}_{names['SLURM_ARRAY_TASK_ID']}"
                        found.append((int(process.name), task))
        return found


def disturbed(lab: Lab) -> None:
    """The order with tasks that end at random, against one process."""
    began = time.monotonic()
    lab.simulate("one-process", TRIALS, SHARD_TRIALS, 1)
    print(f"one process, one thread: {CHUNKS} chunks in {time.monotonic() - began:.1f} s", flush=True)
    order = lab.order("order", TRIALS, SHARD_TRIALS, TASKS)
    chaos = Chaos(lab)
    command: str | None = f"sbatch {order}/job.sh"
    while command:
        chaos.round += 1
        lab.submit(command)
        lab.wait(chaos.step)
        command = missing(lab, order)
        if chaos.round == 1:
            if command is None:
                raise Wrong("nothing is missing although two tasks were ended")
            refused = lab.run(lab.palpate, "cluster", "gather", order, "--out", "too-early", status=1)
            if "missing" not in refused or (lab.folder / "too-early").exists():
                raise Wrong(f"gather before all chunks are made:\n{refused}")
        if chaos.round > CALM_ROUND + 1:
            raise Wrong(f"still missing after a round in which no task was ended: {command}")
    counts = [chaos.ended[way] for way in WAYS]
    print(f"{chaos.round} submissions; processes ended by SIGKILL: {counts[0]}, tasks by scancel: {counts[1]}")
    if 0 in counts:
        raise Wrong(f"not ended in both ways: {dict(chaos.ended)}")
    left_alone(lab, order)
    lab.run(lab.palpate, "cluster", "gather", order, "--out", "gathered")
    compare(lab.folder / "one-process", lab.folder / "gathered")


def missing(lab: Lab, order: pathlib.Path) -> str | None:
    """The command that `cluster status` states for the chunks that are missing, if any are."""
    printed = lab.run(lab.palpate, "cluster", "status", order)
    print("  " + " ".join(next(line for line in printed.splitlines() if " done " in line).split()), flush=True)
    found = re.search(r"sbatch --array=\S+ \S+", printed)
    return found[0] if found else None


def left_alone(lab: Lab, order: pathlib.Path) -> None:
    """The whole job once more changes no result; the folder holds two files per chunk and no unfinished one."""
    before = {path.name: path.stat().st_mtime_ns for path in (order / "results").iterdir()}
    lab.submit(f"sbatch {order}/job.sh")
    lab.wait()
    after = {path.name: path.stat().st_mtime_ns for path in (order / "results").iterdir()}
    ends = collections.Counter(name.partition(".")[2] for name in after)
    if after != before or ends != {"parquet": CHUNKS, "json": CHUNKS}:
        raise Wrong(f"results changed by a job without work, or files that are no results: {dict(ends)}")


def compare(one: pathlib.Path, gathered: pathlib.Path) -> None:
    """Every byte of two folders."""
    names = [sorted(path.name for path in folder.iterdir()) for folder in (one, gathered)]
    if names[0] != names[1]:
        raise Wrong(f"{one.name} holds {names[0]}, {gathered.name} {names[1]}")
    different = [name for name in names[0] if (one / name).read_bytes() != (gathered / name).read_bytes()]
    if different:
        raise Wrong(f"{len(different)} files differ: {' '.join(different)}")
    total = sum(path.stat().st_size for path in one.iterdir())
    print(f"{len(names[0])} files of one process and of the job are equal, {total:,} bytes", flush=True)


def rates(lab: Lab, trials: int) -> None:
    """Trials per second of threads and of tasks, from the moments at which results were complete."""
    shard_trials = -(-trials // RATE_CHUNKS)
    lab.simulate("warm", shard_trials, shard_trials, 1)  # solves what later processes read
    steady = {}
    for count in (1, 2):
        began = time.time()
        lab.simulate(f"threads-{count}", trials, shard_trials, count)
        steady["threads", count] = report(f"1 process, {count} threads", began, trials, count,
                                          lab.folder / f"threads-{count}", "*.parquet")
        order = lab.order(f"tasks-{count}", trials, shard_trials, count)
        began = time.time()
        lab.submit(f"sbatch {order}/job.sh")
        lab.wait(pause_s=0.5)
        steady["tasks", count] = report(f"{count} tasks", began, trials, count, order / "results", "*.json")
    for count in (1, 2):
        print(f"{count} tasks against {count} threads: {steady['tasks', count] / steady['threads', count]:.2f}")
    print(f"2 tasks against twice 1 task: {steady['tasks', 2] / steady['tasks', 1] / 2:.2f}")


def report(what: str, began: float, trials: int, count: int, folder: pathlib.Path, pattern: str) -> float:
    """Prints the rate between the first and the last result, and the time before and after; returns the rate.
    Removes the results."""
    moments = sorted(path.stat().st_mtime for path in folder.glob(pattern))
    first, last = statistics.mean(moments[:count]), statistics.mean(moments[-count:])
    rate = trials * (len(moments) - count) / len(moments) / (last - first)
    overhead = time.time() - began - trials / rate
    shutil.rmtree(folder)
    print(f"{what}: {rate:,.0f} trials/s, and {overhead:.1f} s for start and end", flush=True)
    return rate


def main() -> int:
    """Does what the options state."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("palpate", type=lambda text: str(pathlib.Path(text).resolve()))
    parser.add_argument("--seed", type=int, default=time.time_ns() % 1_000_000)
    parser.add_argument("--rates", type=int, metavar="TRIALS")
    args = parser.parse_args()
    if absent := one_node.missing():
        print(f"left out: not installed: {' '.join(absent)}")
        return int(os.environ.get("PALPATE_REQUIRE_TOOLS") == "1")
    began = time.monotonic()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit(1))
    try:
        with tempfile.TemporaryDirectory(prefix="palpate-cluster-") as folder, one_node.Slurm() as slurm:
            lab = Lab(args.palpate, pathlib.Path(folder), slurm, random.Random(args.seed))
            print(f"{lab.run('sinfo', '--version').strip()} on {os.cpu_count()} CPUs, started in "
                  f"{time.monotonic() - began:.1f} s; --seed {args.seed}", flush=True)
            if args.rates:
                rates(lab, args.rates)
            else:
                disturbed(lab)
    except (Wrong, one_node.NotStarted) as why:
        print(f"FAILED: {why}")
        return 1
    print(f"{time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())

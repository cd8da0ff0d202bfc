"""Slurm of one node, this machine, in a temporary folder (standard library, and Slurm and MUNGE of the distribution).

    python3 tests/cluster/one_node.py

Starts munged, slurmctld and slurmd as this user, with free ports of the loopback address and without systemd,
cgroups, accounting or any file outside the folder. Prints the line `SLURM_CONF=FILE` when the node is idle: with
it in the environment, sbatch, squeue and scancel use this Slurm. Runs until SIGINT or SIGTERM, then ends every
process that the jobs have left and removes the folder. Exit status: 0, 1 if it does not start, 3 if a program is
missing.

Used by `slurm.py`, and by `tests/howto/follow.py` for the pages with the rule `slurm`.
"""

import contextlib
import ctypes
import os
import pathlib
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scancel", "sinfo", "scontrol")
START_S, END_S = 30, 5
PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # prctl(2)
# `KillWait`: seconds from SIGTERM to SIGKILL of a cancelled task. The other values: docs/references.md, "Slurm".
CONFIGURATION = """\
ClusterName=palpate
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmdPort={node_port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
MailProg=/bin/true
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/none
SchedulerType=sched/builtin
SchedulerParameters=batch_sched_delay=0
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
KillWait=5
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} State=UNKNOWN
PartitionName=batch Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


class NotStarted(Exception):
    """Slurm that does not start: why, with the ends of the logs."""


def missing() -> list[str]:
    """The programs that are needed and not installed."""
    return [name for name in PROGRAMS if not program(name)]


def program(name: str) -> str | None:
    """The path of a program; those of the daemons are in sbin, which a user's PATH may lack."""
    return shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")


class Slurm:
    """A running Slurm, as a context: `environment` is that of a process which uses it."""

    def __init__(self) -> None:
        """Makes the folder, the key and the configuration."""
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="palpate-slurm-"))
        self.folder.chmod(0o711)  # munged refuses a socket that not everyone may reach
        for made in ("state", "spool"):
            (self.folder / made).mkdir()
        key = self.folder / "munge.key"
        key.touch(0o600)
        key.write_bytes(os.urandom(128))
        with socket.socket() as first, socket.socket() as second:  # both open: two different ports
            ports = [(s.bind(("127.0.0.1", 0)), s.getsockname()[1])[1] for s in (first, second)]
        self.configuration = self.folder / "slurm.conf"
        self.configuration.write_text(CONFIGURATION.format(
            host=socket.gethostname().partition(".")[0], controller_port=ports[0], node_port=ports[1],
            user=pwd.getpwuid(os.geteuid()).pw_name, folder=self.folder, cpus=os.cpu_count()))
        self.environment = os.environ | {"SLURM_CONF": str(self.configuration)}
        self.daemons: list[subprocess.Popen] = []

    def __enter__(self) -> "Slurm":
        """Starts the three daemons, and waits until the node is idle."""
        prctl(PR_SET_CHILD_SUBREAPER, 1)  # what jobs leave behind becomes a child of this process
        try:
            if not has_address():
                raise NotStarted("Slurm finds no host if 127.0.0.1 is the only address: "
                                 "`ip address add 127.0.0.2/8 dev lo` adds one")
            own = [f"--{what}-file={self.folder}/munge.{what}" for what in ("key", "pid", "seed", "log")]
            # --force: in a user namespace the folder above belongs to nobody, which munged refuses.
            self.start("munged", "--foreground", "--force", f"--socket={self.folder}/munge.socket", *own)
            self.until("munged", lambda: (self.folder / "munge.socket").exists())
            self.start("slurmctld", "-D", "-f", str(self.configuration))
            self.start("slurmd", "-D", "-f", str(self.configuration))
            self.until("slurmctld and slurmd", lambda: self.ask("sinfo", "--noheader", "--format=%T") == "idle")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the daemons and all that descends from this process, and removes the folder."""
        for daemon in reversed(self.daemons):
            daemon.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                daemon.wait(END_S)
        until = time.monotonic() + END_S
        while (left := descendants()) and time.monotonic() < until:
            for pid in left:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            with contextlib.suppress(ChildProcessError):
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass
            time.sleep(0.02)
        shutil.rmtree(self.folder)

    def start(self, name: str, *arguments: str) -> None:
        """Starts a daemon in the foreground, in a session where no Ctrl-C of a terminal reaches it."""
        with (self.folder / f"{name}.out").open("w") as output:
            self.daemons.append(subprocess.Popen(
                [program(name), *arguments], env=self.environment, cwd=self.folder, start_new_session=True,
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                preexec_fn=lambda: prctl(PR_SET_PDEATHSIG, signal.SIGKILL)))

    def until(self, what: str, done) -> None:
        """Waits for a condition; a daemon that ends, or the deadline, is `NotStarted`."""
        until = time.monotonic() + START_S
        while not done():
            if time.monotonic() > until or any(daemon.poll() is not None for daemon in self.daemons):
                raise NotStarted(f"{what}: not started\n{self.logs()}")
            time.sleep(0.05)

    def ask(self, *command: str) -> str:
        """What a program of Slurm prints; empty while the controller does not answer."""
        done = subprocess.run([program(command[0]), *command[1:]], env=self.environment, capture_output=True,
                              text=True, timeout=START_S)
        return done.stdout.strip() if done.returncode == 0 else ""

    def logs(self) -> str:
        """The last lines that the daemons have printed."""
        lines = [f"    {path.name}: {line}" for path in sorted(self.folder.glob("*.out"))
                 for line in path.read_text(errors="replace").splitlines()[-8:]]
        return "\n".join(lines)


def has_address() -> bool:
    """Whether the resolver finds 127.0.0.1 as Slurm asks for it: only if the machine has another address, too."""
    with contextlib.suppress(socket.gaierror):
        return bool(socket.getaddrinfo("127.0.0.1", 0, socket.AF_INET, flags=socket.AI_ADDRCONFIG))
    return False


def prctl(option: int, value: int) -> None:
    """Sets an attribute of this process: prctl(2)."""
    if ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl")


def descendants() -> list[int]:
    """The processes that descend from this one, those excepted that have ended."""
    parents = {}
    for stat in pathlib.Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
            parents[int(stat.parent.name)] = int(parent)
            if state == "Z" and int(parent) != os.getpid():
                del parents[int(stat.parent.name)]
    found, grown = {os.getpid()}, True
    while grown:
        more = {pid for pid, parent in parents.items() if parent in found} - found
        found, grown = found | more, bool(more)
    return sorted(found - {os.getpid()})


def main() -> int:
    """Runs until a signal."""
    if absent := missing():
        print(f"not installed: {' '.join(absent)}", file=sys.stderr)
        return 3
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit(0))
    try:
        with Slurm() as slurm:
            print(f"SLURM_CONF={slurm.configuration}", flush=True)
            while all(daemon.poll() is None for daemon in slurm.daemons):
                time.sleep(0.2)
            print(f"a daemon has ended\n{slurm.logs()}", file=sys.stderr)
    except NotStarted as why:
        print(why, file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())

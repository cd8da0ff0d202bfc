"""Follows docs/how-to/cluster-postgresql.md word for word, with a PostgreSQL that it starts (standard library only); then a
service does over HTTP what the page says of it (`service.py`), and two workers train the nets of a table (`nets.py`).

    python3 tests/cluster/postgresql.py PALPATE

PALPATE is the binary; palpate-worker is next to it, or PALPATE_WORKER names it. All `sh` blocks of the page run in one
shell, in order, in an empty home. `sudo -u postgres` acts as the administrator of the started server, and PGPORT is its
port; everything else is as it is written. The last line of the page compares the result with that of one process.

Exit status: 0, or 1 with the first wrong line or statement. Without PostgreSQL it says that it was skipped, and fails if
PALPATE_REQUIRE_TOOLS is set. Never: a server that outlives it, a file outside of its temporary folder.
"""

import glob
import os
import pathlib
import re
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time

import nets
import service

PAGE = pathlib.Path(__file__).resolve().parents[2] / "docs/how-to/cluster-postgresql.md"
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.M | re.S)
START_S, PAGE_S, END_S = 60, 600, 20
SUDO = """#!/bin/sh
# `sudo -u postgres COMMAND`: the administrator of the server of this test.
shift 2
PGHOST=127.0.0.1 PGUSER=postgres PGPASSWORD={password} exec "$@"
"""
SCRIPT = "set -Eeuo pipefail\ntrap 'echo \"wrong line: $BASH_COMMAND\" >&2' ERR\nset -v\n{}"


def programs() -> pathlib.Path:
    """The folder with initdb and postgres; without PostgreSQL this program ends, as its head states."""
    folders = [*os.environ["PATH"].split(":"), *sorted(glob.glob("/usr/lib/postgresql/*/bin"), reverse=True)]
    found = [folder for folder in folders if all(shutil.which(name, path=folder) for name in ("initdb", "postgres"))]
    if not found or shutil.which("psql") is None:
        print("SKIPPED: no PostgreSQL (initdb, postgres, psql)")
        sys.exit(1 if os.environ.get("PALPATE_REQUIRE_TOOLS") else 0)
    return pathlib.Path(found[0])


class Server:
    """A PostgreSQL server in a folder, ended with its `with` block; `long.py` also kills and starts it."""

    def __init__(self, programs: pathlib.Path, folder: pathlib.Path) -> None:
        """Makes the server's data and starts it; as `nobody` if this is root, which PostgreSQL refuses."""
        self.password = secrets.token_hex(8)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        folder.mkdir()
        password, data = folder / "password", folder / "data"
        password.write_text(self.password)
        user = []
        if os.getuid() == 0:
            user = ["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", "--"]
            for path in (folder, password):
                shutil.chown(path, "nobody")
        subprocess.run([*user, programs / "initdb", "-D", data, "-U", "postgres", "--auth=scram-sha-256", "--no-sync",
                        f"--pwfile={password}"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        self.folder, self.process = folder, None
        self.command = [*user, programs / "postgres", "-D", data, "-p", str(self.port), "-c",
                        "listen_addresses=127.0.0.1", "-c", f"unix_socket_directories={folder}"]

    def __enter__(self) -> "Server":
        until = time.monotonic() + START_S
        while time.monotonic() < until:
            if self.process is None or self.process.poll() is not None:  # not while the killed one's processes end
                self.process = subprocess.Popen(self.command, cwd=self.folder, stderr=subprocess.DEVNULL)
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return self
            except OSError:
                time.sleep(0.1)
        self.__exit__()
        sys.exit(f"PostgreSQL did not answer within {START_S} s")

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        try:
            self.process.wait(END_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def environment(palpate: pathlib.Path, server: Server, folder: pathlib.Path) -> tuple[pathlib.Path, dict[str, str]]:
    """An empty home, and the environment of its shell."""
    home, commands = folder / "home", folder / "bin"
    for made in (home, commands):
        made.mkdir()
    (commands / "sudo").write_text(SUDO.format(password=server.password))
    (commands / "sudo").chmod(0o755)
    (commands / "palpate").symlink_to(palpate)
    worker = os.environ.get("PALPATE_WORKER", str(palpate.with_name("palpate-worker")))
    return home, {"HOME": str(home), "PATH": f"{commands}:{os.environ['PATH']}", "PALPATE_WORKER": worker,
                  "PGPORT": str(server.port), "LANG": "C.UTF-8", "TMPDIR": str(folder)}


def follow(home: pathlib.Path, variables: dict[str, str]) -> int:
    """Runs the blocks of the page, and returns their exit status."""
    blocks = BLOCK.findall(PAGE.read_text())
    if len(blocks) < 8:
        sys.exit(f"{PAGE}: {len(blocks)} blocks, 8 or more expected")
    script = SCRIPT.format("".join(blocks))
    return subprocess.run(["bash", "-c", script], cwd=home, env=variables, timeout=PAGE_S).returncode


def main(arguments: list[str]) -> int:
    """Starts the server and follows the page."""
    if len(arguments) != 1:
        sys.exit(__doc__)
    palpate = pathlib.Path(arguments[0]).resolve()
    found = programs()
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="palpate-cluster-") as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)
        with Server(found, folder / "server") as server:
            home, variables = environment(palpate, server, folder)
            status = follow(home, variables)
            print(f"{PAGE.name}: {'followed' if status == 0 else 'FAILED'} in {time.monotonic() - began:.0f} s")
            if status:
                return 1
            for what, check in (("service with a queue", service.check), ("table of two workers", nets.check)):
                began = time.monotonic()
                try:
                    check(palpate, home, variables)
                except service.Wrong as wrong:
                    print(f"{what}: {wrong}")
                    return 1
                print(f"{what}: as stated in {time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

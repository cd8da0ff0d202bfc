"""Follows README and how-tos as a new user does: every block, in order, in a fresh copy (standard library only).

    python3 tests/howto/follow.py PALPATE [--short] [--cargo] [--folder DIR] [PAGE ..]

PALPATE is the binary that `palpate` and `cargo run --` stand for. Each page gets a copy of the checkout's files,
an empty home, no data, and, if the system allows it, its own network and processes: ports and locks of others do
not matter, and nothing that a page starts outlives it. `--short`: without the blocks marked `long`, virtual rigs
without a speed run at 200, and the pages after the README share its solved skin, also in a second data folder.
`--cargo`: also the blocks that call cargo for more than `cargo run --`. `--folder`: where the copies are made and
kept; by default they are removed.

Prints each block with its exit status and, of a block that failed, the first wrong line. Before that it checks
that every command named in a sentence of a document, and each of its options, exists. Exit status: 0, or 1 if a
block failed; blocks that were left out are counted. With PALPATE_REQUIRE_TOOLS=1 a missing program fails.
`blocks.py` states the rules that a document can give. PALPATE_PYTHON is the interpreter for Python.
"""

import argparse
import contextlib
import doctest
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

import blocks

ROOT = pathlib.Path(__file__).resolve().parents[2]
LIMIT_S, LONG_LIMIT_S, START_S, END_S = 180, 7200, 60, 60
SHORT_SPEED = 200
QUICKSTART = "quickstart/copy/palpate-data"
NEVER_THERE = {"rig", "person", "network"}
CARGO = re.compile(r"^\s*(\.ci/|cargo (?!run --( |$)))", re.M)
# Lines of the log, and of what takes long before a service listens.
BEFORE_READY = re.compile(r"\S+Z +(ERROR|WARN|INFO|DEBUG) |.* \.\. \d+ s$")
TRAP = "set -Eeuo pipefail; trap 'echo \"wrong line: $BASH_COMMAND\" >&2' ERR\n"
SHIM = """#!/usr/bin/env bash
# `palpate`, and with `cargo` before it `cargo run -- ..`.
if [[ "${{0##*/}}" == cargo ]]; then
    [[ "$1 $2" == "run --" ]] || exec {cargo} "$@"
    shift 2
fi
{share}
case " $* " in
    *" --help "* | *" --speed "* | *" --rig "* | *" --url "*) ;;
    " run "*) (exec 3<> /dev/tcp/127.0.0.1/8080) 2> /dev/null || set -- "$@" {speed} ;;
    " serve "*) set -- "$@" {speed} ;;
esac
exec {palpate} "$@"
"""
# A new data folder begins with the skin that is solved for the first one.
SHARE = """if [[ " $* " =~ " --data "([a-z-]+)" " && ! -e "${BASH_REMATCH[1]}" && -d palpate-data/cache ]]; then
    mkdir -m 700 "${BASH_REMATCH[1]}" && cp -a palpate-data/cache "${BASH_REMATCH[1]}/"
fi"""
BENCH = ["palpate", "virtual-rig", "--ephemeral", "--speed", "20", "--out-rig", "RIG.toml"]
OPERATOR = ["palpate", "virtual-operator", "--speed", "20", "--control"]


class Failed(Exception):
    """A block that did not do what the page says: why, with the first wrong line."""


class Running:
    """A command in its own process group, whose output is kept."""

    def __init__(self, script: str, page: "Page", command: list[str] | None = None) -> None:
        """Starts a script with bash, or a command with the script on its standard input."""
        self.process = subprocess.Popen(
            command or ["bash", "-c", script], cwd=page.copy, env=page.environment, start_new_session=True,
            stdin=subprocess.PIPE if command else subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, errors="replace")
        self.lines: list[str] = []
        self.reader = threading.Thread(target=lambda: self.lines.extend(self.process.stdout), daemon=True)
        self.reader.start()
        if command and script:
            self.process.stdin.write(script)
            self.process.stdin.close()

    def output(self) -> str:
        """Everything that it has printed until now."""
        return "".join(self.lines)

    def ready(self) -> bool:
        """Waits for the first line that it prints, those of the log and of progress excepted; false if it
        ends before, or prints none in time."""
        until = time.monotonic() + START_S
        while time.monotonic() < until and self.process.poll() is None:
            if any(not BEFORE_READY.match(line) for line in self.lines):
                return True
            time.sleep(0.05)
        return False

    def wait(self, limit_s: float) -> int:
        """Its exit status; kills it at the limit."""
        try:
            status = self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)
            raise Failed(f"still runs after {limit_s:.0f} s\n{tail(self.output())}") from None
        self.reader.join(2)
        return status

    def signal(self, number: int) -> None:
        """Sends a signal to its process group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    def end(self) -> int:
        """Ends it as Ctrl-C does."""
        self.signal(signal.SIGINT)
        return self.wait(END_S)


class Page:
    """A page that is followed: its copy of the checkout, what it has printed, what it has started."""

    def __init__(self, args: argparse.Namespace, folder: pathlib.Path) -> None:
        """Makes the copy, an empty home, and the programs that the page calls."""
        self.args, self.folder, self.copy = args, folder, folder / "copy"
        for made in ("home", "bin"):
            (folder / made).mkdir(parents=True)
        listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT,
                                check=True, capture_output=True, text=True).stdout
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (self.copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, self.copy / name)
        cargo = shutil.which("cargo") or "false"
        speed, share = (f"--speed {SHORT_SPEED}", SHARE) if args.short else ("", "")
        shim = SHIM.format(cargo=cargo, palpate=args.palpate, speed=speed, share=share)
        for name in ("palpate", "cargo"):
            (folder / "bin" / name).write_text(shim)
            (folder / "bin" / name).chmod(0o755)
        python = pathlib.Path(os.environ.get("PALPATE_PYTHON", sys.executable)).parent
        kept = ("LANG", "CARGO_HOME", "CARGO_TARGET_DIR", "RUSTUP_HOME", "PALPATE_CHROMIUM")
        self.environment = {name: os.environ[name] for name in kept if name in os.environ} | {
            "HOME": str(folder / "home"), "PYTHONDONTWRITEBYTECODE": "1",
            "PYTHONPATH": str(self.copy / "python/src"),  # `palpate` for Python, without an installation
            "PATH": f"{folder / 'bin'}:{python}:{os.environ['PATH']}:/usr/sbin"}
        home = pathlib.Path.home()
        for name, place in (("CARGO_HOME", ".cargo"), ("RUSTUP_HOME", ".rustup")):
            if (home / place).is_dir():
                self.environment.setdefault(name, str(home / place))
        self.printed, self.background, self.control = "", [], ""

    def run(self, block: blocks.Block) -> str:
        """Follows a block; returns what happened, in a few words."""
        rules = block.rules
        if "instead" in rules:
            self.end_background()
        if "bench" in rules:
            self.start_bench(rules["bench"])
        if "mount" in rules:
            self.mount(int(rules["mount"]))
        if "output" in rules:
            missing = blocks.missing_line(block.text, self.printed)
            if missing is not None:
                raise Failed(f"not printed: {missing}")
            return "as printed"
        if "file" in rules:
            (self.copy / rules["file"]).write_text(blocks.filled(block, self.printed))
            return "written"
        if block.language not in ("sh", "python"):
            return "shown"
        if reason := self.left_out(block):
            return f"left out: {reason}"
        if "slurm" in rules:
            self.start_slurm()
        text = blocks.filled(block, self.printed)
        time.sleep(float(rules.get("wait", "0").split()[0]))
        if block.language == "python":
            running = Running(text, self, ["python3", "-"])
        else:
            running = Running(TRAP + text, self)
        began = time.monotonic()
        try:
            status, wanted = self.status(running, rules), int(rules.get("exit", 0))
        finally:
            self.printed += running.output()
        if status is None:
            return "in the background"
        if status != wanted:
            raise Failed(f"exit status {status}\n{tail(running.output())}")
        return f"exit status {status}, {time.monotonic() - began:.1f} s"

    def status(self, running: Running, rules: dict[str, str]) -> int | None:
        """Waits as the rules of the block say; none stands for a block in the background."""
        if "background" in rules:
            if not running.ready():
                running.signal(signal.SIGKILL)
                raise Failed(f"ended, or printed nothing in {START_S} s\n{tail(running.output())}")
            self.background.append(running)
            return None
        if "for" in rules:
            time.sleep(float(rules["for"].split()[0]))
            if running.process.poll() is not None:
                raise Failed(f"ended by itself\n{tail(running.output())}")
            running.end()
            return 0
        return running.wait(LONG_LIMIT_S if "long" in rules else LIMIT_S)

    def left_out(self, block: blocks.Block) -> str | None:
        """Why a block is not run, if it is not."""
        if "long" in block.rules and self.args.short:
            return "long"
        if block.language == "sh" and CARGO.search(block.text) and not self.args.cargo:
            return "calls cargo"
        for need in block.rules.get("needs", "").split():
            if need in NEVER_THERE:
                return f"needs a {need}"
            if not self.has(need):
                if os.environ.get("PALPATE_REQUIRE_TOOLS") == "1":
                    raise Failed(f"{need} is not installed")
                return f"no {need}"
        return None

    def has(self, need: str) -> bool:
        """Whether a program, or a module of Python, is there."""
        found = shutil.which(need, path=self.environment["PATH"])
        return bool(found) or Running(f"python3 -c 'import {need}'", self).wait(LIMIT_S) == 0

    def start_bench(self, file: str) -> None:
        """Starts a virtual rig as the rig of the file RIG.toml; with its operator, if no file describes it."""
        running = Running("", self, [*BENCH, "--rig", file] if file else BENCH)
        self.background.append(running)
        if not running.ready():
            raise Failed(f"the virtual rig did not start\n{tail(running.output())}")
        self.control = json.loads(running.lines[0])["control"]
        if not file:
            self.background.append(Running("", self, [*OPERATOR, self.control]))

    def mount(self, tips: int) -> None:
        """Mounts tips on the virtual rig, as a person does without being asked by a run."""
        host, port = self.control.split(":")
        with socket.create_connection((host, int(port)), START_S) as control, control.makefile("rw") as lines:
            print(json.dumps({"cmd": "mount", "tips": tips}), file=lines, flush=True)
            answer = lines.readline()
        if not json.loads(answer or "{}").get("ok"):
            raise Failed(f"the virtual rig did not mount {tips} tips: {answer}")

    def start_slurm(self) -> None:
        """Starts a Slurm of one node, which the commands of the page find by their environment."""
        running = Running("", self, ["python3", str(ROOT / "tests/cluster/one_node.py")])
        self.background.append(running)
        if not running.ready():
            raise Failed(f"Slurm did not start\n{tail(running.output())}")
        name, _, file = running.lines[0].strip().partition("=")
        self.environment[name] = file

    def end_background(self) -> None:
        """Ends what runs in the background. Until then it must run, or have ended well."""
        ending, self.background, wrong = self.background, [], []
        for running in reversed(ending):
            status = running.process.poll()
            if status is None:
                running.end()
            if status or "panicked at" in running.output():
                why = f"exit status {status}" if status else "panicked"
                wrong.append(f"in the background: {why}\n{tail(running.output())}")
        if wrong:
            raise Failed("\n".join(wrong))


def tail(output: str, count: int = 12) -> str:
    """The wrong line, and the last lines before it."""
    lines = output.splitlines()[-count:]
    lines.sort(key=lambda line: not line.startswith("wrong line: "))
    return "\n".join(f"    | {line[:200]}" for line in lines)


def named_wrongly(palpate: str) -> list[str]:
    """Commands and options that a document names and the program does not have."""
    def help_of(words: tuple[str, ...]) -> str:
        if words not in helps:
            done = subprocess.run([palpate, *words, "--help"], capture_output=True, text=True)
            helps[words] = done.stdout if done.returncode == 0 else ""
        return helps[words]

    helps: dict[tuple[str, ...], str] = {}
    wrong = []
    listed = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", ROOT / "experiments/README.md"]
    for path in [*listed, *sorted((ROOT / "docs").glob("*.md")), *blocks.pages(ROOT)[1:]]:
        for line, command in blocks.inline_commands(path.name, path.read_text()):
            words, place = (), f"{path.relative_to(ROOT)}:{line}: {command}"
            tokens = command.split()[1:]
            while len(words) < len(tokens) and re.fullmatch(r"[a-z][a-z-]+", tokens[len(words)]):
                if re.search(rf"^  {tokens[len(words)]}( |$)", help_of(words), re.M):
                    words = (*words, tokens[len(words)])
                else:
                    break
            if not words and tokens and not tokens[0].startswith(("-", "COMMAND", "..")):
                wrong.append(f"{place}: no such command")
            for option in re.findall(r"(?<=\s)--[a-z][a-z-]*", command):
                if not re.search(rf"{option}\b", help_of(words)):
                    wrong.append(f"{place}: no option {option}")
    return wrong


def quickstart(args: argparse.Namespace, folder: pathlib.Path) -> pathlib.Path:
    """A data folder with a quickstart, made once."""
    data = folder / QUICKSTART
    if not data.is_dir():
        page = Page(args, folder / "quickstart")
        running = Running(f"palpate run experiments/quickstart.toml --speed {SHORT_SPEED}", page)
        if running.wait(LIMIT_S):
            raise Failed(f"the quickstart failed\n{tail(running.output())}")
    return data


def follow(path: pathlib.Path, args: argparse.Namespace, folder: pathlib.Path) -> tuple[int, int, int]:
    """Follows a page; returns the number of blocks that passed, were left out, and failed."""
    name = str(path.relative_to(ROOT))
    print(f"\n== {name}", flush=True)
    passed = left = failed = 0
    page = Page(args, folder / path.stem)
    try:
        found = blocks.blocks_of(name, path.read_text())
        if any("after" in block.rules for block in found):
            shutil.copytree(quickstart(args, folder), page.copy / "palpate-data")
        elif args.short and (folder / QUICKSTART).is_dir():
            (page.copy / "palpate-data").mkdir(mode=0o700)
            shutil.copytree(folder / QUICKSTART / "cache", page.copy / "palpate-data/cache")
        for block in found:
            first, *more = block.text.strip().splitlines()
            print(f"{name}:{block.line}: {first[:90]}{f' (+{len(more)})' if more else ''}", flush=True)
            try:
                result = page.run(block)
                left += result.startswith("left out")
                passed += not result.startswith(("left out", "shown"))
                print(f"    {result}", flush=True)
            except (Failed, blocks.DocumentError) as wrong:
                failed += 1
                print(f"    FAILED: {wrong}", flush=True)
    except (Failed, blocks.DocumentError) as wrong:
        failed += 1
        print(f"    FAILED: {wrong}", flush=True)
    try:
        page.end_background()
    except Failed as wrong:
        failed += 1
        print(f"    FAILED: {wrong}", flush=True)
    if args.short and name == "README.md" and not failed:
        shutil.copytree(page.copy / "palpate-data", folder / QUICKSTART)
    if not args.folder:
        shutil.rmtree(folder / path.stem)
    return passed, left, failed


def alone() -> None:
    """Continues in its own network, processes and folder of locks, where the system allows that."""
    if os.environ.get("FOLLOW_ALONE"):
        if os.environ["FOLLOW_ALONE"] == "1":
            subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
            # A resolver that is asked for configured addresses, as Slurm does, does not count 127.0.0.1.
            subprocess.run(["ip", "address", "add", "127.0.0.2/8", "dev", "lo"], check=True)
            subprocess.run(["mount", "-t", "tmpfs", "-o", "mode=1777", "tmpfs", "/run/lock"], check=True)
        return
    namespaces = ["unshare", "--net", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
    if os.geteuid() != 0:
        namespaces += ["--map-current-user", "--keep-caps"]  # Slurm refuses to run as root of a user namespace
    check = ["sh", "-c", "ip link set lo up && test -d /run/lock"]
    possible = shutil.which("unshare") and subprocess.run([*namespaces, *check], capture_output=True).returncode == 0
    os.environ["FOLLOW_ALONE"] = "1" if possible else "no"
    if possible:
        os.execvp(namespaces[0], [*namespaces, sys.executable, *sys.argv])
    print("not alone: ports 8080 and the locks of rigs are shared with everything else on this machine")
    with socket.socket() as probe:
        if probe.connect_ex(("127.0.0.1", 8080)) == 0:
            sys.exit("another service has port 8080: stop it first")


def main() -> int:
    """Follows the pages that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("palpate", type=lambda text: str(pathlib.Path(text).resolve()))
    parser.add_argument("pages", nargs="*", type=lambda text: pathlib.Path(text).resolve())
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--cargo", action="store_true")
    parser.add_argument("--folder", type=pathlib.Path)
    args = parser.parse_intermixed_args()
    # A shell that starts this in the background has SIGINT ignored, also in what the blocks start: they would not end.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    alone()
    if doctest.testmod(blocks).failed:
        return 1
    began = time.monotonic()
    wrong = named_wrongly(args.palpate)
    print("\n".join(["== commands within sentences", *wrong]), flush=True)
    counts = [0, 0, len(wrong)]
    with tempfile.TemporaryDirectory(prefix="palpate-follow-") as scratch:
        folder = args.folder.resolve() if args.folder else pathlib.Path(scratch)
        for path in args.pages or blocks.pages(ROOT):
            counts = [a + b for a, b in zip(counts, follow(path, args, folder))]
    passed, left, failed = counts
    print(f"\n{passed} passed, {left} left out, {failed} failed, {time.monotonic() - began:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

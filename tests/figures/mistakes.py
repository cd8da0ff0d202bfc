"""Answers of an earlier program to the mistakes of tests/it/mistakes, next to those of today.

    git worktree add ../before def6f5f && cd ../before
    cargo build --no-default-features --bin palpate     # the version that the review tried: about 20 minutes
    cd - && python3 tests/figures/mistakes.py ../before PALPATE_OF_BEFORE FULL.txt > table

Runs each line of files.txt and commands.txt in a folder with the experiments of the earlier checkout, writes whole
answers to FULL.txt in the form of the tables, and prints a table of first lines. service.txt needs a service whose
commands the earlier program lacks. An answer that does not come within 20 s is ended. Takes some minutes.
"""

import os
import re
import shutil
import signal
import socketserver
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

TABLES = Path(__file__).resolve().parents[1] / "it/mistakes"
LIMIT_S = 20
CELL = 110


class Stranger(socketserver.BaseRequestHandler):
    """A web server that is not palpate."""

    def handle(self):
        self.request.recv(1024)
        self.request.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 5\r\nconnection: close\r\n\r\nhello")


def mistakes(table):
    """Title, lines that prepare it, and pairs of a typed line and today's answer."""
    for part in ("\n" + (TABLES / table).read_text()).split("\n## ")[1:]:
        title, *lines = part.splitlines()
        prepared, typed, answer = [], [], None
        for line in lines:
            if answer is not None:
                answer.append(line)
                if re.fullmatch(r"\[exit .*\]", line):
                    answer = None
            elif line.startswith("> "):
                prepared.append(line[2:])
            elif line.startswith("$ "):
                answer = []
                typed.append((line[2:], answer))
        yield title, prepared, typed


def prepare(folder, checkout, lines):
    """Writes the file of a mistake; a text if that version's file has not what is changed."""
    path = None
    for line in lines:
        kind, rest = line.split(" ", 1)
        if kind == "file":
            name, base = rest.split(" = ")
            path, base = folder / name, checkout / "experiments" / base
            path.write_bytes(base.read_bytes() if base.is_file() else b"")
        elif kind == "with":
            path.write_text(path.read_text() + rest + "\n")
        else:
            old, new = rest.split(" => ") if " => " in rest else (rest.removesuffix(" =>"), "")
            text = path.read_text()
            if old not in text:
                return f"(its {path.name} has no `{old}`)"
            path.write_text(text.replace(old, new, 1))
    return None


def answer(folder, program, line):
    """What the program prints, with its exit code."""
    env = {"HOME": str(folder), "PATH": f"{program.parent}:/usr/bin:/bin", "USER": "ada"}
    env |= {"PALPATE_DATA": "data", "PALPATE_URL": "http://127.0.0.1:9"}
    shell = ["bash", "-o", "pipefail", "-c", f"{{ {line}\n}} 2>&1"]
    done = subprocess.Popen(shell, cwd=folder, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                            start_new_session=True)
    try:
        text, code = done.communicate(timeout=LIMIT_S)[0], str(done.returncode)
    except subprocess.TimeoutExpired:
        os.killpg(done.pid, signal.SIGTERM)
        try:
            text = done.communicate(timeout=LIMIT_S)[0]
        except subprocess.TimeoutExpired:
            os.killpg(done.pid, signal.SIGKILL)
            text = done.communicate()[0]
        code = f"none within {LIMIT_S} s"
    lines = text.decode(errors="replace").replace(str(folder), "HERE").splitlines()
    return [*lines, f"[exit {code}]"]


def cell(lines):
    """The first line that states something, and the exit code; marks a drawn line of the file."""
    *said, code = lines
    wrong = (line for line in said if "WRONG" in line)
    first = next(wrong, None) or next((line for line in said if line.strip()), "nothing")
    first = re.sub(r"127\.0\.0\.1:\d+", "127.0.0.1:PORT", first)
    first = first if len(first) <= CELL else first[: CELL - 2].rstrip() + " .."
    drawn = " (line drawn)" if any(line.lstrip().startswith("--> ") for line in said) else ""
    return f"`{first.replace('|', chr(92) + '|').replace('`', chr(39))}`{drawn}, {code[1:-1]}"


def main():
    checkout, program, full = (Path(argument).resolve() for argument in sys.argv[1:4])
    other = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Stranger)
    other.daemon_threads = True
    threading.Thread(target=other.serve_forever, daemon=True).start()
    print("| mistake | before | now |\n|---|---|---|")
    written, counts = [], {"all": 0, "drawn before": 0, "drawn now": 0, "did you mean before": 0, "did you mean now": 0}
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made).resolve()
        shutil.copytree(checkout / "experiments", folder, dirs_exist_ok=True)
        (folder / "other").write_text(f"http://127.0.0.1:{other.server_address[1]}")
        for table in ["files.txt", "commands.txt"]:
            for title, prepared, typed in mistakes(table):
                lacks = prepare(folder, checkout, prepared)
                for line, now in typed:
                    before = [lacks, "[exit none]"] if lacks else answer(folder, program, line)
                    print(f"| {title} | {cell(before)} | {cell(now)} |", flush=True)
                    written += [f"## {title}", *(f"> {of}" for of in prepared), f"$ {line}", *before, ""]
                    counts["all"] += 1
                    for when, lines in [("before", before), ("now", now)]:
                        text = "\n".join(lines)
                        counts[f"drawn {when}"] += " --> " in text
                        counts[f"did you mean {when}"] += "did you mean" in text or "a similar" in text
    full.write_text("\n".join(written))
    print("\n" + ", ".join(f"{what} {count}" for what, count in counts.items()) + ".")


main()

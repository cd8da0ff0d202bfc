"""A virtual rig, its operator and a service of a figure: started, asked, ended (standard library only)."""

import json
import os
import pathlib
import socket
import subprocess
import sys
import threading
import time
import urllib.request

START_S, END_S, JOB_S = 300, 60, 600
WHO = "figures"
# A net as small as it can be: how good it is does not matter to a page.
RECIPE = """name = 'small-%d'\nrows = 640\n[training]\nseed = %d\nepochs = 1\nbatch = 64
[training.net]\nkind = 'point-net'\nhidden = 1\nwidth = 64\n[training.noise]\nwhite_v = 1.2e-3\n"""


def until(what, done, seconds, pause=0.2):
    """Waits for a fact; returns it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := done():
            return found
        time.sleep(pause)
    raise SystemExit(f"waited {seconds} s for {what}")


def call(url, path, body=None, seconds=20, key=""):
    """The answer of a service: JSON, or else its text."""
    headers = {"Content-Type": "application/json"} | ({"Authorization": f"Bearer {key}"} if key else {})
    data = None if body is None else json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(url + path, data, headers), timeout=seconds) as answer:
        text, is_json = answer.read().decode(), "json" in answer.headers.get("Content-Type", "")
    return json.loads(text) if text and is_json else text


def tell(control, command):
    """Sends a line to the control socket of a virtual rig; returns what it answers."""
    host, port = control.rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=30) as wire:
        wire.sendall(json.dumps(command).encode() + b"\n")
        return json.loads(wire.makefile().readline())


def together(work):
    """Calls functions with their arguments at the same time, each in a thread, and waits for all."""
    threads = [threading.Thread(target=one, args=arguments) for one, *arguments in work]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def share(values, q):
    """The value below which a share of the values is."""
    return sorted(values)[min(len(values) - 1, int(q * len(values)))]


def answer(printed):
    """The answer of a command with --json: its last line."""
    return json.loads(printed.splitlines()[-1])


def memory_mb(process):
    """Largest memory of a process until now."""
    status = pathlib.Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1000


def once(folder, name, *command):
    """Runs a command once and returns what it printed; later it returns the same from a file."""
    done = folder / f"{name}.done"
    if not done.exists():
        print(f"{folder.name}: {name}", file=sys.stderr, flush=True)
        ran = subprocess.run([*map(str, command)], stdout=subprocess.PIPE, text=True)
        if ran.returncode:
            raise SystemExit(f"{folder.name}: {name}: exit status {ran.returncode}; run the same command again")
        done.write_text(ran.stdout)
    return done.read_text()


class Bench:
    """`palpate serve` on a data folder, with a virtual rig and an operator that mounts tips.

    `serve`: further options of the service.
    """

    def __init__(self, palpate, data, speed=20.0, serve=()):
        self.palpate, self.data = pathlib.Path(palpate).resolve(), pathlib.Path(data)
        self.data.mkdir(parents=True, exist_ok=True)
        (self.data / "server.json").unlink(missing_ok=True)
        self.log = open(self.data / "figures.log", "a")
        self.processes = []
        try:
            self.open(speed, serve)
        except BaseException:
            for process in self.processes:
                process.terminate()
            raise

    def open(self, speed, serve):
        """Starts the rig, the service on it, and the operator."""
        rig = self.data / "served.toml"
        ready = self.start("virtual-rig", "--ephemeral", "--speed", speed, "--out-rig", rig, "--data", self.data,
                           "--with-parent", stdout=subprocess.PIPE).stdout.readline()
        if not ready:
            raise SystemExit(f"the virtual rig did not start: see {self.log.name}")
        self.control = json.loads(ready)["control"]
        self.service = self.start("serve", "--data", self.data, "--rig", rig, "--bind", "127.0.0.1:0", "--local-admin",
                                  *serve)
        self.url = until("the service", self.address, START_S)
        self.start("virtual-operator", "--url", self.url, "--control", self.control, "--speed", speed, "--with-parent")

    def start(self, *words, stdout=None):
        """Starts a command of the program. Its input is a pipe: some commands end when it closes."""
        process = subprocess.Popen([self.palpate, *map(str, words)], stdin=subprocess.PIPE, stderr=self.log,
                                   stdout=stdout or self.log, text=True, env={**os.environ, "NO_PROXY": "*"})
        self.processes.append(process)
        return process

    def address(self):
        """Address of the service, once it listens."""
        if self.service.poll() is not None:
            raise SystemExit(f"the service ended: see {self.log.name}")
        file = self.data / "server.json"
        return file.exists() and json.loads(file.read_text())["url"]

    def api(self, path, body=None, seconds=300):
        """The answer of the service."""
        return call(self.url, f"/api/v1{path}", body, seconds)

    def home(self):
        """Opens the wires and homes the axes."""
        for action in ("connect", "home"):
            self.api("/rig/actions", {"action": action, "who": WHO})
        until("homing", lambda: self.api("/status")["rig"]["state"] == "homed", START_S)

    def carried(self, name):
        """Queues an experiment that the program carries; returns the run."""
        item = next(one for one in self.api("/experiments")["items"] if one["name"] == name)
        return self.queue(item["text"])

    def queue(self, definition):
        """Queues an experiment by its text; returns the run."""
        return self.api("/queue", {"file": "figures.toml", "definition": definition, "who": WHO})

    def begin(self, run):
        """Arms and starts a run; waits for its first trial."""
        code = self.api(f"/runs/{run['uid']}/arm", {"who": WHO})["code"]
        self.api(f"/runs/{run['uid']}/actions", {"action": "start", "code": code, "who": WHO})
        self.stored(1)

    def stored(self, trials):
        """Waits until the active run has stored trials."""
        enough = lambda: ((self.api("/status")["run"] or {}).get("trials_stored") or 0) >= trials
        until(f"{trials} trials", enough, START_S)

    def ended(self, run, seconds):
        """Waits for the end of a run."""
        until("the end of the run", lambda: self.api(f"/runs/{run['uid']}")["state"] == "ended", seconds)

    def net(self, seed=1):
        """Trains a net as small as it can be; returns its id. Each seed gives another net."""
        job = self.api("/trainings", {"recipe": RECIPE % (seed, seed)})["id"]
        over = lambda: (row := self.api(f"/jobs/{job}"))["state"] not in ("waiting", "running") and row
        row = until("the training", over, JOB_S, pause=1.0)
        if row["state"] != "done":
            raise SystemExit(f"the training failed: {row['error']}")
        return row["result"]["model"]

    def hands(self, **command):
        """Tells the virtual rig what hands do."""
        reply = tell(self.control, command)
        if not reply["ok"]:
            raise SystemExit(f"{command}: {reply}")

    def close(self):
        """Ends the service, then the rig."""
        self.service.terminate()
        self.service.wait(END_S)
        for process in self.processes:
            process.stdin.close()
        for process in self.processes:
            process.wait(END_S)
        self.log.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

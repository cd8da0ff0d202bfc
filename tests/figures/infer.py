"""Speed of answers compared with onnxruntime's, in one run (onnxruntime, numpy).

    cargo build --example infer_speed
    python3 tests/figures/infer.py PATH/TO/infer_speed [ROUNDS [SECONDS [NAME ..]]]

For each net that Palpate trains: in each round tract at one caller (batch 1 and 64) and two callers (batch
64), then onnxruntime with one thread and with its default, SECONDS each. Prints medians over rounds and
ratios to onnxruntime's one thread (of rates: above 1 is faster than onnxruntime).
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy
import onnxruntime
from bench import share

NAMES = ["transfer", "transfer-residual", "points", "recon-32", "recon-64", "recon-160"]


def tract(program: str, model: Path, batch: int, seconds: float, callers: int) -> dict:
    command = [program, "time", str(model), str(batch), str(seconds), str(callers)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def ort(model: Path, batch: int, seconds: float, threads: int) -> dict:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    frames = {name: numpy.random.default_rng(2).normal(0, 0.05, (batch, 784)).astype("f4")}
    for _ in range(3):
        session.run(None, frames)
    latencies, begun = [], time.perf_counter()
    while time.perf_counter() < begun + seconds:
        asked = time.perf_counter()
        session.run(None, frames)
        latencies.append((time.perf_counter() - asked) * 1e3)
    rate = len(latencies) * batch / (time.perf_counter() - begun)
    return {"latencies_ms": latencies, "frames_per_s": rate}


def main(program: str, rounds: int, seconds: float, names: list[str]) -> None:
    ways = {
        "tract": lambda model, batch: tract(program, model, batch, seconds, 1),
        "tract, 2 callers": lambda model, batch: tract(program, model, batch, seconds, 2),
        "onnxruntime, 1 thread": lambda model, batch: ort(model, batch, seconds, 1),
        "onnxruntime, default": lambda model, batch: ort(model, batch, seconds, 0),
    }
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([program, "write", folder], check=True)
        for name in names:
            model = Path(folder, name).with_suffix(".onnx")
            found = {(way, batch): [] for way in ways for batch in (1, 64)}
            del found["tract, 2 callers", 1]
            for _ in range(rounds):
                for way, batch in found:
                    found[way, batch].append(ways[way](model, batch))
            once = found["tract", 1][0]
            print(f"{name}: file {once['file_kib'] >> 10} MiB, plans {once['plan_kib'] >> 10} MiB, load {once['load_s']:.2f} s")
            report(found)


def report(found: dict) -> None:
    for batch in (1, 64):
        base = rate(found["onnxruntime, 1 thread", batch])
        for (way, size), runs in found.items():
            if size != batch:
                continue
            at = lambda q: statistics.median(share(run["latencies_ms"], q) for run in runs)
            print(
                f"  batch {batch:2}, {way:22} p50 {at(0.5):8.2f} ms, p99 {at(0.99):8.2f} ms, "
                f"{rate(runs):8.0f} frames/s, ratio {rate(runs) / base:.2f}"
            )


def rate(runs: list[dict]) -> float:
    return statistics.median(run["frames_per_s"] for run in runs)


if __name__ == "__main__":
    main(
        sys.argv[1],
        int(sys.argv[2]) if len(sys.argv) > 2 else 5,
        float(sys.argv[3]) if len(sys.argv) > 3 else 2.0,
        sys.argv[4:] or NAMES,
    )

"""The paper's tables and figures from as many trials as the paper has, from nothing.

    python3 tests/figures/paper_scale.py PALPATE FOLDER [--speed 200] [--skin-seed 5] [--epochs 5] [--finest-mm 10]
        [--only STEP,..]

Presses the paper's Real-Hex (198,000 trials) and 600 trials of Real-Random, simulates 200,000 trials of Sim-Random,
calibrates the model, and computes Figs. 12, 11, 10 and Tables III and IV: all rows, split by trial as in the paper, maps
of 10 and 20 mm, or of 20 mm only (`--finest-mm 20`; without Fig. 11). `--epochs` is what two processors can train in
hours; the paper has 1024. Each step is done once: the same command continues after it was stopped, a run at its next
trial and a training at its last checkpoint. For tables of the trials that are pressed so far, copy FOLDER/data to
another folder, and name the other steps there (`--only`). The data folder is FOLDER/data, tables and figures are in
FOLDER/tables. At the end it prints how long each step took; a step that was stopped counts from its last start. PALPATE
is the program that was built.
"""

import argparse
import json
import pathlib
import time

from bench import answer, once
from skins import experiments

# All rows: more than any dataset has.
ROWS = 1_000_000


def steps(palpate, folder, args):
    """Name and command of each step, in order."""
    data, tables = folder / "data", folder / "tables"
    skin = ["--gap", args.gap, "--skin-seed", args.skin_seed, "--speed", args.speed]
    extent = ["--scale", "medium", "--rows", ROWS, "--epochs", args.epochs, "--finest-mm", args.finest_mm, "--by-trial"]
    shown = [*extent, "--out", tables, "--json"]
    yield "real-hex", [palpate, "run", experiments() / "real-hex.toml", *skin]
    yield "real-random", [palpate, "run", experiments() / "touch-real-random.toml", *skin]
    free = data / "sim-random" / "free"
    yield "sim-random", [palpate, "simulate", "random", "--trials", 200_000, "--seed", 1, "--out", free]
    yield "calibration", [palpate, "calibrate", "skin", "--run", 1, "--out", folder / "skin.toml"]
    yield "added", [palpate, "model", "add-calibration", folder / "skin.toml", "--json"]
    added = folder / "added.done"
    calibration = answer(added.read_text())["calibration"] if added.exists() else "cal-"
    yield "promoted", [palpate, "model", "promote", calibration]
    for what in ["unseen", "factorial", "noise", "transfer", "maps"]:
        if what != "factorial" or args.finest_mm != 20:
            yield what, [palpate, "evaluate", what, *shown]


def main():
    """Does the steps that are not done, and prints how long each took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--gap", default="gap-a", help="physics of the virtual skin")
    parser.add_argument("--skin-seed", default=5, type=int, help="seed of its fields")
    parser.add_argument("--speed", default=200, type=int, help="seconds of the rig per second")
    parser.add_argument("--epochs", default=5, type=int, help="epochs of each net")
    parser.add_argument("--finest-mm", default=10, type=int, help="finest pixel of the maps")
    parser.add_argument("--only", help="steps to do, separated by commas [default: all]")
    args = parser.parse_args()
    folder, kept = args.folder.resolve(), args.folder.resolve() / "seconds.json"
    folder.mkdir(parents=True, exist_ok=True)
    took = json.loads(kept.read_text()) if kept.exists() else {}
    for name, command in steps(args.palpate.resolve(), folder, args):
        if args.only and name not in args.only.split(","):
            continue
        is_done, began = (folder / f"{name}.done").exists(), time.monotonic()
        once(folder, name, *command, "--data", folder / "data")
        if not is_done:
            took[name] = round(time.monotonic() - began)
            kept.write_text(json.dumps(took) + "\n")
    print("\n".join(f"{name}: {seconds} s" for name, seconds in took.items()))


if __name__ == "__main__":
    main()

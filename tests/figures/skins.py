"""Table of accuracy on virtual skins: every skin, method and number of frames, from nothing.

    python3 tests/figures/skins.py PALPATE FOLDER [--skins gap-c:5,gap-c:6,gap-d:1] [--paper] [--points] [--table]

For each skin: 9,900 trials to learn from (touch-real-hex), 600 a day later for evaluation only (touch-real-random),
its calibration, and `evaluate unseen` with `exact` and the one-step methods; `--points` trains a Point-Net and adds
`fast`, `--paper` the paper's pipeline and its end-to-end net at small scale. Each skin has a data folder in FOLDER, each
step is done once: the same command continues after it was stopped. `--table` prints what there is, and does nothing else.
PALPATE is the program that was built. On two cores a skin takes about 20 minutes, `--points` 5 and `--paper` 10 more.

A cell is a mean with its 95 % interval. Below the methods of each skin is the perfect map: the true contacts as the
paper's map, read by its rule. Coverage is the share of pairs whose 95 % region holds the true place and force.
"""

import argparse
import json
import pathlib

from bench import once

# gap:seed. Gap d is for reporting only: no method was chosen by it.
SKINS = "gap-a:5,gap-a:8,gap-b:3,gap-c:5,gap-c:6,gap-c:7,gap-d:1,gap-d:2"
SPEED = {"gap-a": 200, "gap-b": 200, "gap-c": 60, "gap-d": 60}
COLUMNS = ["skin", "method", "trials", "location mm", "closest mm", "force %", "number %", "right count %",
           "ghosts/trial", "place in 95 % region", "force in it"]


def step(folder, name, *command):
    """What a command printed that is run once, on the data folder of a skin."""
    return once(folder, name, *command, "--data", folder)


def measure(palpate, folder, gap, seed, points, paper):
    """Presses, calibrates and evaluates a skin."""
    folder.mkdir(parents=True, exist_ok=True)
    skin = ["--gap", gap, "--skin-seed", seed, "--speed", SPEED[gap]]
    step(folder, "real-hex", palpate, "run", experiments() / "touch-real-hex.toml", *skin)
    step(folder, "real-random", palpate, "run", experiments() / "touch-real-random.toml", *skin, "--skin-age-days", 1)
    file = folder / "skin.toml"
    step(folder, "calibration", palpate, "calibrate", "skin", "--run", 1, "--out", file)
    added = step(folder, "added", palpate, "model", "add-calibration", file, "--json")
    calibration = answer(added)["calibration"]
    step(folder, "promoted", palpate, "model", "promote", calibration)
    options = ["--out", folder / "tables", "--json"]
    if points:
        step(folder, "point-net", palpate, "train", "point-net", "--epochs", 10)
        options += ["--points", "point-net"]
    if paper:
        simulated = folder / "sim-random" / "free"
        step(folder, "sim-random", palpate, "simulate", "random", "--trials", 20000, "--seed", 1, "--out", simulated)
    else:
        options.append("--ours")
    name = "-".join(["unseen", *(["points"] if points else []), *(["paper"] if paper else [])])
    step(folder, name, palpate, "evaluate", "unseen", *options)
    untouched = ["--dataset", "real-untouched", "--where", "max_force_n__lt=0.1", "--json"]
    step(folder, "untouched", palpate, "evaluate", "method", "exact", *untouched)


def answer(printed):
    """The answer of a command with --json: its last line."""
    return json.loads(printed.splitlines()[-1])


def experiments():
    """The experiment files of this checkout."""
    return pathlib.Path(__file__).resolve().parents[2] / "experiments"


def cell(mean, scale=1.0):
    """A mean with its interval, or a dash."""
    if not mean:
        return "-"
    low, high = mean.get("low_95"), mean.get("high_95")
    text = f"{scale * mean['mean']:.3g}"
    return text if low is None else f"{text} [{scale * low:.3g}, {scale * high:.3g}]"


def closest(score):
    """The distance to the closest estimate, with the share of the contacts that have one."""
    mean = score.get("closest_mm")
    share = mean["n"] / max(score["contacts"], 1) if mean else 1.0
    return cell(mean) if share > 0.995 else f"{cell(mean)} of {100 * share:.0f} %"


def row(skin, method, score):
    """A row of the table from a score of a report."""
    get = score.get
    return [skin, method, score["trials"], cell(get("location_mm")), closest(score), cell(get("force_percent")),
            cell(get("number_percent")), cell(get("exact_rate"), 100), cell(get("ghosts_per_trial")),
            cell(get("place_in_95"), 100), cell(get("force_in_95"), 100)]


def rows(skin, numbers):
    """Rows of a skin: the methods of `evaluate unseen`, the best of the paper's nets, and the perfect map."""
    found, perfect = [], {}
    best = [entry for entry in numbers["real_to_sim"] if entry["name"] == numbers["best"]]
    for group, entries in [("", numbers["ours"]), ("paper, best: ", best), ("end to end, ", numbers["end_to_end"])]:
        for entry in entries:
            report = entry["report"]
            found.append(row(skin, group + entry["name"], report["contacts"]["all"]))
            if report.get("perfect"):
                name = f"perfect map {report.get('map') or ''}, {report['threshold_n']} N rule"
                perfect[name] = row(skin, name, report["perfect"]["all"])
    return found + list(perfect.values())


def table(folder, skins):
    """Prints the table of the skins that are done, and how many methods found contacts on untouched skins."""
    lines, ghosts = [], []
    for gap, seed in skins:
        # The file of the largest set of methods.
        done = sorted((folder / f"{gap}-{seed}").glob("unseen*.done"), key=lambda file: len(file.name))
        if not done:
            continue
        lines += rows(f"{gap}, seed {seed}", answer(done[-1].read_text()))
        file = folder / f"{gap}-{seed}" / "untouched.done"
        if file.exists():
            score = answer(file.read_text())["report"]["contacts"]["all"]
            ghosts.append(f"{gap}, seed {seed}: {score['estimates']} in {score['trials']}")
    for line in [COLUMNS, ["---"] * len(COLUMNS), *lines]:
        print("| " + " | ".join(map(str, line)) + " |")
    if ghosts:
        print("\nContacts that exact finds in frames of the untouched skin: " + "; ".join(ghosts) + ".")


def main():
    """Measures the skins that are not done, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--skins", default=SKINS, help="GAP:SEED, separated by commas")
    parser.add_argument("--points", action="store_true", help="train a Point-Net, and score fast")
    parser.add_argument("--paper", action="store_true", help="train and score the paper's nets, at small scale")
    parser.add_argument("--table", action="store_true", help="print what there is, and measure nothing")
    args = parser.parse_args()
    skins = [tuple(skin.split(":")) for skin in args.skins.split(",")]
    unknown = [skin for skin in skins if len(skin) != 2 or skin[0] not in SPEED]
    if unknown:
        raise SystemExit(f"--skins: {unknown[0]}: must be GAP:SEED with one of {', '.join(SPEED)}")
    folder = args.folder.resolve()
    for gap, seed in [] if args.table else skins:
        measure(args.palpate.resolve(), folder / f"{gap}-{seed}", gap, seed, args.points, args.paper)
    table(folder, skins)


if __name__ == "__main__":
    main()

"""Table of accuracy on virtual skins: every skin, method and number of frames, from nothing.

    python3 tests/figures/skins.py PALPATE FOLDER [--skins gap-c:5,gap-c:6,gap-d:1] [--paper] [--points] [--frames N]
        [--table]

For each skin: 9,900 trials to learn from (touch-real-hex), 600 a day later for evaluation only (touch-real-random),
its calibration, and `evaluate unseen` with `exact` and the one-step methods; `--points` trains a Point-Net and adds
`fast`, `--paper` the paper's pipeline and its end-to-end net, with ridge and kernel ridge regression on the rows of the
latter, at small scale. Each skin has a data folder in FOLDER, each step is done once: the same command continues after
it was stopped. PALPATE is the program that was built. On two cores a skin takes about 20 minutes, `--points` 5 and
`--paper` 10 more, without the regressions, which were not timed.

`--frames N` presses with N frames per trial, not one, from which the skin is calibrated; its folder is another one.

Skins may be measured on several days: `--skins gap-c:6` today, another tomorrow. The scores of a skin are kept in
FOLDER/GAP-SEED.json with the day on which they were measured, and the table is that of all such files, also of files
that another machine made; its data folder is not needed for it. `--table` prints it, and does nothing else.

A cell is a mean with its 95 % interval. Below the methods of each skin is the perfect map: the true contacts as the
paper's map, read by its rule. Coverage is the share of pairs whose 95 % region holds the true place and force.
"""

import argparse
import datetime
import json
import pathlib

from bench import answer, once

# gap:seed. The methods were developed on gaps a and c; gap d is for reporting.
SKINS = "gap-a:5,gap-a:8,gap-b:3,gap-c:5,gap-c:6,gap-c:7,gap-d:1,gap-d:2"
SPEED = {"gap-a": 200, "gap-b": 200, "gap-c": 60, "gap-d": 60}
COLUMNS = ["skin", "day", "method", "trials", "location mm", "closest mm", "force %", "number %", "right count %",
           "ghosts/trial", "place in 95 % region", "force in it"]


def step(folder, name, *command):
    """What a command printed that is run once, on the data folder of a skin."""
    return once(folder, name, *command, "--data", folder)


def real_hex(folder, frames):
    """The experiment of the trials to learn from; with several frames per trial a file in the folder."""
    carried = experiments() / "touch-real-hex.toml"
    if frames == 1:
        return carried
    text = carried.read_text().replace('"sensors/', f'"{experiments()}/sensors/')
    file = folder / carried.name
    file.write_text(f"{text}\n[measure]\nframes_per_trial = {frames}\n")
    return file


def measure(palpate, folder, gap, seed, points, paper, frames):
    """Presses, calibrates and evaluates a skin, and keeps its scores."""
    folder.mkdir(parents=True, exist_ok=True)
    skin = ["--gap", gap, "--skin-seed", seed, "--speed", SPEED[gap]]
    step(folder, "real-hex", palpate, "run", real_hex(folder, frames), *skin)
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
    keep(folder, gap, seed, frames)


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


def scores(numbers):
    """Scores of a skin: the methods of `evaluate unseen`, the best of the paper's nets, those that learn from measured
    trials alone with the regressions on the same rows, and the perfect map."""
    best = [entry for entry in numbers["real_to_sim"] if entry["name"] == numbers["best"]]
    groups = [("", numbers["ours"]), ("paper, best: ", best), ("end to end, ", numbers["end_to_end"])]
    groups += [(f"{other['name']}, ", other["nets"]) for other in numbers["regressions"]]
    found, perfect = [], {}
    for group, entries in groups:
        for entry in entries:
            report = entry["report"]
            found.append({"method": group + entry["name"], "score": report["contacts"]["all"]})
            if report.get("perfect"):
                name = f"perfect map {report.get('map') or ''}, {report['threshold_n']} N rule"
                perfect[name] = {"method": name, "score": report["perfect"]["all"]}
    return found + list(perfect.values())


def keep(folder, gap, seed, frames):
    """Writes the scores of a skin next to its data folder, of the largest set of methods that was measured."""
    done = max(folder.glob("unseen*.done"), key=lambda file: len(file.name))
    numbers = answer(done.read_text())
    untouched = answer((folder / "untouched.done").read_text())["report"]["contacts"]["all"]
    day = datetime.date.fromtimestamp(done.stat().st_mtime)
    kept = {"gap": gap, "seed": int(seed), "frames_per_trial": frames, "day": str(day), "scores": scores(numbers), "verdicts": numbers.get("verdicts", []),
            "untouched": {name: untouched[name] for name in ("estimates", "trials")}}
    (folder.parent / f"{folder.name}.json").write_text(json.dumps(kept, indent=1) + "\n")


def row(skin, day, method, score):
    """A row of the table."""
    get = score.get
    return [skin, day, method, score["trials"], cell(get("location_mm")), closest(score), cell(get("force_percent")),
            cell(get("number_percent")), cell(get("exact_rate"), 100), cell(get("ghosts_per_trial")),
            cell(get("place_in_95"), 100), cell(get("force_in_95"), 100)]


def table(folder):
    """Prints the table of the skins whose scores are kept, which nets do not beat a regression, and how many contacts
    were found on untouched skins."""
    kept = sorted((json.loads(file.read_text()) for file in folder.glob("gap-*.json")),
                  key=lambda skin: (skin["gap"], skin["seed"]))
    lines, verdicts, ghosts = [], [], []
    for skin in kept:
        name, untouched = f"{skin['gap']}, seed {skin['seed']}", skin["untouched"]
        frames = skin.get("frames_per_trial", 1)
        name += f", calibrated on means of {frames} frames" if frames > 1 else ""
        lines += [row(name, skin["day"], entry["method"], entry["score"]) for entry in skin["scores"]]
        verdicts += [f"{name}: {line}" for line in skin["verdicts"]]
        ghosts.append(f"{name}: {untouched['estimates']} in {untouched['trials']}")
    for line in [COLUMNS, ["---"] * len(COLUMNS), *lines]:
        print("| " + " | ".join(map(str, line)) + " |")
    print("\n".join(["", *verdicts]))
    print("Contacts that exact finds in frames of the untouched skin: " + "; ".join(ghosts or ["not measured"]) + ".")


def main():
    """Measures the skins that are not done, and prints the table of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--skins", default=SKINS, help="skins to measure, GAP:SEED, separated by commas")
    parser.add_argument("--points", action="store_true", help="train a Point-Net, and score fast")
    parser.add_argument("--paper", action="store_true", help="train and score the paper's nets and regressions, small scale")
    parser.add_argument("--frames", type=int, default=1, help="frames per trial of the run to learn from")
    parser.add_argument("--table", action="store_true", help="print the table of what was measured")
    args = parser.parse_args()
    skins = [tuple(skin.split(":")) for skin in args.skins.split(",")]
    unknown = [skin for skin in skins if len(skin) != 2 or skin[0] not in SPEED or not skin[1].isdecimal()]
    if unknown:
        raise SystemExit(f"--skins: {':'.join(unknown[0])}: must be GAP:SEED with one of {', '.join(SPEED)}")
    folder = args.folder.resolve()
    for gap, seed in [] if args.table else skins:
        name = f"{gap}-{seed}" + (f"-frames-{args.frames}" if args.frames > 1 else "")
        measure(args.palpate.resolve(), folder / name, gap, seed, args.points, args.paper, args.frames)
    table(folder)


if __name__ == "__main__":
    main()

"""Nets next to ridge and kernel ridge regression on two kinds of skins that are not Palpate's, from nothing.

    python3 tests/figures/other_skins.py PALPATE FOLDER [--rows 2500] [--noise 0.003,0.05,0.2] [--seeds 7,8,9]
        [--skins pad,sheet] [--recipe RECIPE ..]

Makes trials of a pad of 192 channels with one contact, and of a sheet of 3,000 channels with up to three of nine places
pressed (tests/it/evaluate/python/skins.py: numpy and pyarrow), for each noise, as a share of the channels' standard
deviation, and each seed. Imports them, splits them 3 to 1 to 1 by trial, and prints one table of `palpate evaluate
quantity`: every net on the same rows as both regressions. The error of the pad is a distance in mm, that of the sheet
the share of trials with any wrong place, %, each with its 95 % interval. A net meets the aim if it has a third less
error than ridge regression and no more than kernel ridge regression. Each step is done once: the same command continues
after it was stopped, and a part of it (a noise, a seed, a skin) may be measured before. --recipe: nets to train, a
carried recipe or a file [default: mlp].
"""

import argparse
import pathlib
import sys

from bench import answer, once

MAKE = pathlib.Path(__file__).resolve().parents[1] / "it" / "evaluate" / "python" / "skins.py"
QUANTITIES = {"pad": "position", "sheet": "pattern"}
REGRESSIONS = ["ridge", "kernel ridge"]
# Largest error of a net that meets the aim, as a share of each regression's.
AIMS = [2 / 3, 1.0]
COLUMNS = ["skin", "noise", "seed", "net", "trials", "error, mm or %", "of ridge", "of kernel ridge", "meets the aim"]


def numbers(palpate, folder, skin, recipes, *made):
    """What `evaluate quantity` found on a skin that is made with a number of rows, noise and seed."""
    folder.mkdir(parents=True, exist_ok=True)
    data = ["--data", folder / "data"]
    once(folder, "make", sys.executable, MAKE, "make", folder, *made)
    named = ["--sensor", folder / f"{skin}.toml", "--label", "virtual", "--name", f"{skin}-trials"]
    once(folder, f"{skin}-import", palpate, "dataset", "import", folder / f"{skin}.parquet", *named, *data)
    once(folder, f"{skin}-dataset", palpate, "dataset", "make", folder / f"{skin}-split.toml", *data)
    options = ["--dataset", skin, "--out", folder / "tables", "--json", *data]
    options += [word for recipe in recipes for word in ("--recipe", recipe)]
    name = "-".join([skin, *(pathlib.Path(recipe).stem for recipe in recipes)])
    printed = once(folder, name, palpate, "evaluate", "quantity", QUANTITIES[skin], *options)
    return answer(printed)


def error(scores):
    """Mean error and its interval: mm, or the share of trials that are not right, %."""
    right, ends = scores.get("right"), ["mean", "low_95", "high_95"]
    if right:
        return [100 * (1 - right[name]) for name in [ends[0], ends[2], ends[1]]]
    return [scores["error"][name] for name in ends]


def rows(found):
    """Cells of each net from its name on."""
    errors = {net["name"]: error(net["scores"]) for net in found["nets"]}
    for net in found["nets"]:
        mean, low, high = errors[net["name"]]
        of = [mean / errors[name][0] if errors[name][0] else float("nan") for name in REGRESSIONS]
        meets = all(mean <= aim * errors[name][0] for aim, name in zip(AIMS, REGRESSIONS))
        aim = "" if net["name"] in REGRESSIONS else "yes" if meets else "NO"
        shown = f"{mean:.3g} [{low:.3g}, {high:.3g}]"
        yield [net["name"], net["scores"]["rows"], shown, *(f"{share:.2f}" for share in of), aim]


def main():
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--rows", type=int, default=2500)
    parser.add_argument("--noise", default="0.003,0.05,0.2", help="shares, separated by commas")
    parser.add_argument("--seeds", default="7,8,9", help="seeds of the trials, separated by commas")
    parser.add_argument("--skins", default="pad,sheet", help="pad, sheet or both, separated by commas")
    parser.add_argument("--recipe", action="append", help="may be repeated")
    args = parser.parse_args()
    skins = args.skins.split(",")
    if unknown := set(skins) - set(QUANTITIES):
        raise SystemExit(f"--skins: {unknown.pop()}: must be one of {', '.join(QUANTITIES)}")
    print("| " + " | ".join(COLUMNS) + " |\n|" + " --- |" * len(COLUMNS), flush=True)
    for skin in skins:
        for noise in args.noise.split(","):
            for seed in args.seeds.split(","):
                folder = args.folder.resolve() / f"{args.rows}-{noise}-{seed}"
                found = numbers(args.palpate.resolve(), folder, skin, args.recipe or ["mlp"], args.rows, noise, seed)
                for cells in rows(found):
                    print("| " + " | ".join(map(str, [skin, noise, seed, *cells])) + " |", flush=True)


if __name__ == "__main__":
    main()

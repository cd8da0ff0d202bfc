"""Nets next to ridge and kernel ridge regression on two kinds of skins that are not Palpate's, from nothing.

    python3 tests/figures/other_skins.py PALPATE FOLDER [--rows 2500] [--noise 0.003,0.05,0.2] [--recipe RECIPE ..]

Makes trials of a pad of 192 channels with one contact, and of a sheet of 3,000 channels with up to three of nine places
pressed (tests/it/evaluate/python/skins.py: numpy and pyarrow), for each noise, as a share of the channels' standard
deviation. Imports them, splits them 3 to 1 to 1 by trial, and prints the tables of `palpate evaluate quantity`: every
net on the same rows as both regressions, with 95 % intervals, and which regression it does not beat. Each step is done
once: the same command continues after it was stopped. --recipe: nets to train, a carried recipe or a file [default:
mlp].
"""

import argparse
import pathlib
import sys

from bench import once

MAKE = pathlib.Path(__file__).resolve().parents[1] / "it" / "evaluate" / "python" / "skins.py"


def main():
    """Prints two tables for each noise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--rows", type=int, default=2500)
    parser.add_argument("--noise", default="0.003,0.05,0.2", help="shares, separated by commas")
    parser.add_argument("--recipe", action="append", help="may be repeated")
    args = parser.parse_args()
    palpate, recipes = args.palpate.resolve(), args.recipe or ["mlp"]
    for noise in args.noise.split(","):
        folder = args.folder.resolve() / f"{args.rows}-{noise}"
        folder.mkdir(parents=True, exist_ok=True)
        data = ["--data", folder / "data"]
        once(folder, "make", sys.executable, MAKE, "make", folder, args.rows, noise)
        for skin, quantity in [("pad", "position"), ("sheet", "pattern")]:
            trials, sensor = folder / f"{skin}.parquet", folder / f"{skin}.toml"
            named = ["--sensor", sensor, "--label", "virtual", "--name", f"{skin}-trials"]
            once(folder, f"{skin}-import", palpate, "dataset", "import", trials, *named, *data)
            once(folder, f"{skin}-dataset", palpate, "dataset", "make", folder / f"{skin}-split.toml", *data)
            options = ["--dataset", skin, "--out", folder / "tables", *data]
            options += [word for recipe in recipes for word in ("--recipe", recipe)]
            stems = "-".join(pathlib.Path(recipe).stem for recipe in recipes)
            table = once(folder, f"{skin}-{stems}", palpate, "evaluate", "quantity", quantity, *options)
            print(f"\nnoise of {noise}, {args.rows} trials:\n\n{table}", flush=True)


if __name__ == "__main__":
    main()

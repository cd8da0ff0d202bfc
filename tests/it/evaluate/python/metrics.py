"""Recomputes what the Rust test answered, from the same inputs, and fails on the first difference.

Reads JSON from standard input. Peaks: scipy.ndimage; matching: scipy.optimize; scores: numpy and
sklearn.metrics; analysis of variance: least squares on sum-to-zero contrasts, each effect by the
model without it (type III), scipy.stats.
"""

import json
import sys

import numpy as np
from scipy import ndimage, optimize, spatial, stats
from sklearn import metrics

CIRCLE_MM = 32.0
EQUAL = 1e-6
SPACINGS_MM = 0.0, 60.0, 120.0, np.inf
SIDE_MM, SKIN_MM = 640.0, (540.0, 560.0)


def same(what, ours, theirs, relative=1e-9, absolute=1e-9):
    ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
    assert ours.shape == theirs.shape, f"{what}: {ours.tolist()} for {theirs.tolist()}"
    close = np.isclose(ours, theirs, relative, absolute)
    assert close.all(), f"{what}: {ours.tolist()}, not {theirs.tolist()}"


def circle(pixel_mm):
    reach = int(CIRCLE_MM // pixel_mm)
    steps = np.arange(-reach, reach + 1) * pixel_mm
    return np.hypot(steps[:, None], steps[None, :]) <= CIRCLE_MM + 1e-6


def find_peaks(pixels, pixel_mm, threshold_n):
    """Peaks (x_mm, y_mm, force_n, diameter_mm), in no order."""
    force = np.where(np.isfinite(pixels) & (pixels > 0), pixels, 0).astype(np.float32)
    largest = ndimage.maximum_filter(force, footprint=circle(pixel_mm), mode="constant")
    summits = (force > 0) & (force >= largest * (1 - EQUAL))
    plateaus = {}
    for row, column in np.argwhere(summits):
        labels, _ = ndimage.label(force >= force[row, column] * (1 - EQUAL))
        plateau = labels == labels[row, column]
        plateaus.setdefault(tuple(np.argwhere(plateau)[0]), plateau)
    centres = (np.arange(len(force)) + 0.5) * pixel_mm
    found = []
    for first, plateau in plateaus.items():
        rows, columns = np.nonzero(plateau)
        found.append((-force[plateau].max(), first, centres[columns].mean(), centres[rows].mean()))
    places, peaks = [], []
    for height, first, x_mm, y_mm in sorted(found):
        if any(np.hypot(x_mm - x, y_mm - y) <= CIRCLE_MM + 1e-6 for x, y in places):
            continue
        places.append((x_mm, y_mm))
        away = np.hypot(centres[None, :] - x_mm, centres[:, None] - y_mm)
        force_n = force[away <= CIRCLE_MM + 1e-6].astype(float).sum()
        if force_n >= threshold_n:
            labels, _ = ndimage.label(force >= -height / 2)
            area = (labels == labels[first]).sum() * pixel_mm**2
            origin = [(skin - SIDE_MM) / 2 for skin in SKIN_MM]
            place = (origin[0] + x_mm, origin[1] + y_mm)
            peaks.append((*place, force_n, 2 * np.sqrt(area / np.pi)))
    return peaks


def check_peaks(cases):
    count = 0
    for case in cases:
        side = round(SIDE_MM / case["pixel_mm"])
        pixels = np.array([np.nan if p is None else p for p in case["map"]], np.float32)
        peaks = find_peaks(pixels.reshape(side, side), case["pixel_mm"], case["threshold_n"])
        same("peaks", sorted(case["peaks"]), sorted(map(list, peaks)), 1e-6)
        count += len(peaks)
    assert count > 0, "no peak in any map"
    return f"{count} peaks of {len(cases)} maps"


def distances(truths, estimates):
    a = np.array(truths, float).reshape(-1, 2)
    b = np.array(estimates, float).reshape(-1, 2)
    return np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])


def check_matchings(cases):
    for case in cases:
        cost = distances(case["truths"], case["estimates"])
        rows, columns = optimize.linear_sum_assignment(cost)
        same("pairs", len(case["pairs"]), len(rows))
        ours = sum(cost[truth, estimate] for truth, estimate in case["pairs"])
        # Ours counts whole micrometres.
        same("total distance", ours, cost[rows, columns].sum(), absolute=1e-2)
    return f"{len(cases)} matchings"


def frame_values(truths, estimates):
    """Values of each metric for one frame."""
    cost = distances([(t["x_mm"], t["y_mm"]) for t in truths],
                     [(e["x_mm"], e["y_mm"]) for e in estimates])
    rows, columns = optimize.linear_sum_assignment(cost)

    def percent(key):
        return [100 * (estimates[c][key] / truths[r][key] - 1) for r, c in zip(rows, columns)]

    ghosts = (cost > 40).all(axis=0).sum()
    return {
        "number_percent": [100 * (len(estimates) / len(truths) - 1)] if truths else [],
        "location_mm": list(cost[rows, columns]),
        "closest_mm": list(cost.min(axis=1)) if estimates else [],
        "force_percent": percent("force_n"),
        "diameter_percent": percent("diameter_mm"),
        "exact_rate": [float(len(truths) == len(estimates))],
        "ghosts_per_trial": [float(ghosts)],
    }


def check_score(what, score, frames):
    values = [frame_values(*frame) for frame in frames]
    same(f"{what}: trials", score["trials"], len(frames))
    same(f"{what}: contacts", score["contacts"], sum(len(truths) for truths, _ in frames))
    for name in values[0]:
        pooled = np.concatenate([np.array(frame[name], float) for frame in values])
        ours = score.get(name)
        if len(pooled) == 0:
            assert ours is None, f"{what}: {name} of nothing is {ours}"
            continue
        same(f"{what}: {name}", [ours["mean"], ours["n"]], [pooled.mean(), len(pooled)])
        same(f"{what}: {name} sd", ours["sd"], pooled.std(ddof=1))
        check_interval(f"{what}: {name}", ours, [frame[name] for frame in values])
    numbers = [[len(truths), len(estimates)] for truths, estimates in frames]
    exact = metrics.accuracy_score(*np.transpose(numbers))
    same(f"{what}: exact_rate", score["exact_rate"]["mean"], exact)
    for name, median in [("force_percent", "force_median_percent"),
                         ("location_mm", "location_median_mm")]:
        off = np.concatenate([np.array(frame[name], float) for frame in values])
        if len(off):
            theirs = metrics.median_absolute_error(np.zeros_like(off), off)
            same(f"{what}: {median}", score[median], theirs)


def check_interval(what, ours, by_frame):
    """Other draws, so near, not equal: within a fifth of the interval's width."""
    sums = np.array([sum(values) for values in by_frame])
    counts = np.array([len(values) for values in by_frame])
    draws = np.random.default_rng(1).integers(0, len(sums), (2000, len(sums)))
    rounds = sums[draws].sum(axis=1) / np.maximum(counts[draws].sum(axis=1), 1)
    low, high = np.percentile(rounds, [2.5, 97.5])
    slack = 0.2 * (high - low) + 1e-9
    same(f"{what} interval", [ours["low_95"], ours["high_95"]], [low, high], 0, slack)


def spacing(truths):
    """Distance of the two closest contacts, to 0.1 mm; not a number with fewer than two."""
    places = np.array([(truth["x_mm"], truth["y_mm"]) for truth in truths], float)
    return spatial.distance.pdist(places).min().round(1) if len(places) > 1 else np.nan


def check_scores(case):
    frames, scores = case["frames"], case["scores"]
    check_score("all", scores["all"], frames)
    groups = sorted({len(truths) for truths, _ in frames})
    same("groups", [group["contacts"] for group in scores["by_contacts"]], groups)
    for group in scores["by_contacts"]:
        count = group["contacts"]
        chosen = [frame for frame in frames if len(frame[0]) == count]
        check_score(f"{count} contacts", group["score"], chosen)
    ranges = list(zip(SPACINGS_MM, SPACINGS_MM[1:]))
    ours = [(group["from_mm"], group.get("to_mm", np.inf)) for group in scores["by_spacing"]]
    same("ranges of the spacing", ours, ranges)
    for (low, high), group in zip(ranges, scores["by_spacing"]):
        chosen = [frame for frame in frames if low <= spacing(frame[0]) < high]
        check_score(f"spacing from {low} mm", group["score"], chosen)
    return f"scores of {len(frames)} frames in {len(groups)} groups"


def check_differences(cases):
    for case in cases:
        pair = np.float64(case["measured"]), np.float64(case["simulated"])
        same("RMSE", case["rmse_v"], np.sqrt(metrics.mean_squared_error(*pair)))
        same("FVU", case["fvu"], 1 - metrics.r2_score(*pair))
    return f"{len(cases)} frames' RMSE and FVU"


def contrasts(levels, count):
    """Columns of sum-to-zero coding of a factor."""
    coding = np.vstack([np.eye(count - 1), -np.ones(count - 1)])
    return coding[levels]


def check_anova(case):
    levels = np.array([row[0] for row in case["rows"]])
    values = np.array([row[1] for row in case["rows"]])
    anova = case["anova"]
    counts = [len(factor["levels"]) for factor in anova["factors"]]
    blocks = [np.ones((len(values), 1))]
    for effect in anova["effects"]:
        block = np.ones((len(values), 1))
        for factor in effect["factors"]:
            columns = contrasts(levels[:, factor], counts[factor])
            block = (block[:, :, None] * columns[:, None, :]).reshape(len(values), -1)
        blocks.append(block)

    def unexplained(kept):
        design = np.hstack(kept)
        return ((values - design @ np.linalg.lstsq(design, values)[0]) ** 2).sum()

    error, df = unexplained(blocks), len(values) - int(np.prod(counts))
    same("error", [anova["error_sum_of_squares"], anova["error_df"]], [error, df])
    assert len({tuple(effect["factors"]) for effect in anova["effects"]}) == 2 ** len(counts) - 1
    for number, effect in enumerate(anova["effects"], 1):
        what = f"effect of {effect['factors']}"
        added = unexplained(blocks[:number] + blocks[number + 1:]) - error
        own_df = blocks[number].shape[1]
        f = added / own_df / (error / df)
        same(f"{what}: SS, df", [effect["sum_of_squares"], effect["df"]], [added, own_df], 1e-7)
        same(f"{what}: F", effect["f"], f, 1e-7)
        same(f"{what}: p", effect["p"], stats.f.sf(f, own_df, df), 1e-6, 1e-300)
    check_means(anova, levels, values, error / df)
    return f"{len(anova['effects'])} effects of {len(values)} samples"


def check_means(anova, levels, values, mean_square):
    for mean in anova["means"]:
        held = [(f, level) for f, level in enumerate(mean["levels"]) if level is not None]
        chosen = np.all([levels[:, f] == level for f, level in held], axis=0)
        cells, samples = np.unique(levels[chosen], axis=0, return_counts=True)
        means = [values[(levels == cell).all(axis=1)].mean() for cell in cells]
        error = np.sqrt(mean_square * (1 / samples).sum()) / len(cells)
        ours = [mean["mean"], mean["standard_error"], mean["n"]]
        same("marginal mean", ours, [np.mean(means), error, chosen.sum()])
        if chosen.sum() > 1:
            same("marginal sd", mean["sd"], values[chosen].std(ddof=1))


CHECKS = {
    "peaks": check_peaks,
    "matchings": check_matchings,
    "score": check_scores,
    "differences": check_differences,
    "anovas": lambda cases: "; ".join(map(check_anova, cases)),
}

# Numbers that, changed by this part of themselves, must be seen to be wrong.
SPOILED = [
    ("peaks", "0/peaks/0/2", 1e-5),
    ("peaks", "0/peaks/0/3", 0.01),
    ("matchings", "0/pairs/0/1", 1.0),
    ("score", "scores/all/location_mm/mean", 1e-6),
    ("score", "scores/all/closest_mm/sd", 1e-6),
    ("score", "scores/all/closest_mm/low_95", 0.2),
    ("score", "scores/all/force_median_percent", 1e-6),
    ("score", "scores/by_contacts/3/score/exact_rate/mean", 1e-6),
    ("score", "scores/by_spacing/0/score/location_mm/mean", 1e-6),
    ("differences", "3/fvu", 1e-6),
    ("anovas", "0/anova/effects/5/sum_of_squares", 1e-6),
    ("anovas", "0/anova/effects/0/p", 1e-5),
    ("anovas", "0/anova/means/4/standard_error", 1e-6),
]


def spoiled_passes(part, path, by, answers):
    """Whether a check does not see that one number is wrong."""
    *way, last = [int(step) if step.isdigit() else step for step in path.split("/")]
    holder = answers
    for step in way:
        holder = holder[step]
    right = holder[last]
    holder[last] = type(right)(right * (1 + by) + (by if right == 0 else 0))
    try:
        CHECKS[part](answers)
    except (AssertionError, IndexError):
        return False
    finally:
        holder[last] = right
    return True


def main():
    answers = json.load(sys.stdin)
    for part, check in CHECKS.items():
        print(f"{part}: {check(answers[part])}")
    # Cases that have something to change, and few of those that take long.
    few = {
        **answers,
        "peaks": [case for case in answers["peaks"] if case["peaks"]][-1:],
        "matchings": [case for case in answers["matchings"] if case["pairs"]][:1],
        "anovas": answers["anovas"][:1],
    }
    for part, path, by in SPOILED:
        assert not spoiled_passes(part, path, by, few[part]), f"{part}/{path} is wrong and passes"
    print(f"spoiled: {len(SPOILED)} wrong numbers are seen")


main()

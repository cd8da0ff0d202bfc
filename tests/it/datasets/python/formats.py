"""The same trials in each format that `palpate dataset import` reads, as other labs' programs write them.

    python tests/it/datasets/python/formats.py OUT_DIR

A pad of 6 channels and 100 x 100 mm: OUT_DIR/pad.toml. OUT_DIR/trials.parquet, .csv, .npz, and .mat with and without
compression hold the same 5 trials.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.io

out = Path(sys.argv[1])
(out / "pad.toml").write_text('name = "pad"\nchannels = 6\nwidth_mm = 100\nheight_mm = 100\n')
volts = np.round(np.random.default_rng(6).normal(0, 0.5, (5, 6)), 3).astype(np.float32)
volts[1, 4] = np.nan
nan = np.nan
xy = np.array([[[10, 20], [30, 40]], [[15.5, 25], [nan, nan]], [[nan, nan], [nan, nan]], [[1, 2], [3, 4]], [[5, 6], [nan, nan]]])
force = np.array([[2.5, 3.5], [nan, nan], [nan, nan], [1, nan], [7, nan]])
depth = np.array([0.5, 1.0, 1.5, nan, 2.5])
configuration = np.array([4, 4, 7, 8, 9], dtype=np.int32)
depth_index = np.array([0, 1, 0, 0, 0], dtype=np.int64)
frame_count = np.array([8, 8, 8, 1, 0], dtype=np.uint32)
split = np.array(["train", "train", "test", "validation", ""])
tag = np.array(["tip A", "tip A", "tip B", "", "tip B"])

arrays = {"voltages_v": volts, "contacts_xy_mm": xy, "force_n": force, "depth_mm": depth,
          "configuration": configuration, "depth_index": depth_index, "weather": np.arange(5), "frame_count": frame_count, "split": split,
          "tag": tag}
np.savez_compressed(out / "trials.npz", **{**arrays, "voltages_v": np.asfortranarray(volts)})
scipy.io.savemat(out / "trials.mat", arrays, do_compression=False, oned_as="column")
arrays["split"], arrays["tag"] = split.astype(object), tag.astype(object)  # cell arrays
scipy.io.savemat(out / "packed.mat", arrays, do_compression=True, oned_as="row")


def contacts(row: int) -> list[dict]:
    """Those that are there."""
    found = []
    for (x, y), f in zip(xy[row], force[row]):
        if not np.isnan(x):
            found.append({"x_mm": x, "y_mm": y, "force_n": None if np.isnan(f) else f})
    return found


scalars = {"depth_mm": depth, "configuration": configuration, "depth_index": depth_index, "weather": np.arange(5), "frame_count": frame_count,
           "split": [part or None for part in split], "tag": [text or None for text in tag]}
pd.DataFrame({"voltages_v": [list(row) for row in volts], "contacts": [contacts(row) for row in range(5)],
              **scalars}).to_parquet(out / "trials.parquet")
cells = {f"v{n}": volts[:, n] for n in range(6)}
for n in range(2):
    cells |= {f"x{n + 1}_mm": xy[:, n, 0], f"y{n + 1}_mm": xy[:, n, 1], f"force{n + 1}_n": force[:, n]}
pd.DataFrame({**cells, **scalars}).to_csv(out / "trials.csv", index=False)

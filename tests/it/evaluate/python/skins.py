"""Two kinds of skins that are not Palpate's, as sheets of resistors, and what scikit-learn makes of them.

`skins.py make FOLDER ROWS [NOISE [SEED]]`: trials of a pad (192 channels, one contact) and of a sheet (3,000 channels,
up to three of nine places pressed), as Parquet files with their sensor files and datasets' definitions. NOISE: share of
the channels' standard deviation, 0.003 by default.
`skins.py compare DATA_FILE pad|sheet`: errors of ridge and kernel ridge regression on the part test of a
dataset's file, with penalties and widths chosen on its part validation, as JSON.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

SIDE = 18  # Nodes along each side of a sheet.
SIZE_MM = 200.0
PLACES_MM = [(x, y) for y in (40.0, 100.0, 160.0) for x in (40.0, 100.0, 160.0)]


def nodes_mm():
    axis = np.linspace(0.0, SIZE_MM, SIDE)
    return np.array([(x, y) for y in axis for x in axis])


def impedances(contacts, at):
    """Transfer impedances between electrodes `at`: contacts (x, y, force) make the sheet conduct better,
    less than proportionally to the force."""
    places = nodes_mm()
    gain = np.ones(len(places))
    for x, y, force in contacts:
        square = (places[:, 0] - x) ** 2 + (places[:, 1] - y) ** 2
        gain += 1.5 * force**0.7 * np.exp(-square / (2 * 18.0**2))
    laplacian = np.zeros((len(places),) * 2)
    node = np.arange(len(places)).reshape(SIDE, SIDE)
    for a, b in ((node[:, :-1], node[:, 1:]), (node[:-1], node[1:])):
        a, b = a.ravel(), b.ravel()
        g = 2.0 / (1.0 / gain[a] + 1.0 / gain[b])
        np.add.at(laplacian, (a, b), -g)
        np.add.at(laplacian, (b, a), -g)
        np.add.at(laplacian, (a, a), g)
        np.add.at(laplacian, (b, b), g)
    ground = laplacian[:-1, :-1]  # The last node, a corner, is no electrode.
    columns = np.zeros((len(ground), len(at)))
    columns[at, np.arange(len(at))] = 1.0
    return np.linalg.solve(ground, columns)[at]


def boundary(count):
    node = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    ring = np.concatenate([node[0, :-1], node[:-1, -1], node[-1, ::-1][:-1], node[::-1, 0][:-1]])
    ring = ring[ring != SIDE * SIDE - 1]
    return ring[np.linspace(0, len(ring), count, endpoint=False).astype(int)]


def pairs_of_pad():
    """16 adjacent injections, each read by 12 adjacent pairs that do not touch it."""
    of = lambda k: (k % 16, (k + 1) % 16)
    return [(of(i), of(i + 2 + j)) for i in range(16) for j in range(12)]


def pairs_of_sheet(chance):
    pair = lambda: tuple(chance.choice(32, 2, replace=False))
    drives = [pair() for _ in range(60)]
    reads = [pair() for _ in range(50)]
    return [(drive, read) for drive in drives for read in reads]


def frames(all_contacts, at, pairs, chance, share):
    (i, j), (m, n) = (np.array(side).T for side in zip(*pairs))
    volts = []
    for contacts in all_contacts:
        z = impedances(contacts, at)
        volts.append(z[m, i] - z[m, j] - z[n, i] + z[n, j])
    volts = np.array(volts)
    noise = share * np.std(volts, axis=0).mean()
    return (volts + noise * chance.normal(size=volts.shape)).astype(np.float32)


def write(folder, name, volts, all_contacts):
    contact = pa.struct({"x_mm": pa.float64(), "y_mm": pa.float64(), "force_n": pa.float64()})
    listed = [[dict(zip(("x_mm", "y_mm", "force_n"), c)) for c in row] for row in all_contacts]
    table = pa.table({
        "voltages_v": pa.array(volts.tolist(), pa.list_(pa.float32())),
        "contacts": pa.array(listed, pa.list_(contact)),
    })
    pq.write_table(table, folder / f"{name}.parquet")
    (folder / f"{name}.toml").write_text(
        f'name = "{name}"\nchannels = {volts.shape[1]}\nwidth_mm = {SIZE_MM}\nheight_mm = {SIZE_MM}\n'
    )
    (folder / f"{name}-split.toml").write_text(
        f'name = "{name}"\ntask = "real"\nruns = ["{name}-trials"]\nuntouched = "keep"\n'
        '[split]\nby = "trial"\nseed = 1\n'
    )


def make(folder, rows, noise=0.003, seed=7):
    chance = np.random.default_rng(int(seed))
    touch = lambda: (*chance.uniform(15.0, SIZE_MM - 15.0, 2), chance.uniform(1.0, 10.0))
    contacts = [[touch()] for _ in range(rows)]
    write(folder, "pad", frames(contacts, boundary(16), pairs_of_pad(), chance, noise), contacts)
    contacts = []
    for _ in range(rows):
        pressed = chance.choice(len(PLACES_MM), chance.integers(0, 4), replace=False)
        contacts.append([(*PLACES_MM[k], chance.uniform(1.0, 10.0)) for k in pressed])
    write(folder, "sheet", frames(contacts, boundary(32), pairs_of_sheet(chance), chance, noise), contacts)


def targets(kind, rows):
    if kind == "pad":
        return np.array([(row[0]["x_mm"], row[0]["y_mm"]) for row in rows])
    is_pressed = lambda row, place: any((c["x_mm"], c["y_mm"]) == place for c in row)
    return np.array([[float(is_pressed(row, place)) for place in PLACES_MM] for row in rows])


def error(kind, answers, truth):
    if kind == "pad":
        return np.hypot(*(answers - truth).T).mean()
    return ((answers > 0.5) != (truth > 0.5)).any(axis=1).mean()


def compare(path, kind):
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.linear_model import Ridge
    from sklearn.preprocessing import StandardScaler

    table = pq.read_table(path, columns=["voltages_v", "contacts", "split"])
    x = np.array(table["voltages_v"].to_pylist(), dtype=float)
    y = targets(kind, table["contacts"].to_pylist())
    part = np.array(table["split"].to_pylist())
    x = StandardScaler().fit(x[part == "train"]).transform(x)
    mean = y[part == "train"].mean(axis=0)
    of = lambda name: (x[part == name], y[part == name] - mean)
    (x0, y0), (x1, y1), (x2, y2) = of("train"), of("validation"), of("test")
    unit = (x0**2).sum() / min(x0.shape)
    models = {
        "ridge": [Ridge(alpha=unit * 10**e) for e in np.arange(-10, 2.5, 0.5)],
        "kernel ridge": [
            KernelRidge(kernel="rbf", gamma=g / x.shape[1], alpha=10**e)
            for g in (1e-4, 1e-3, 4e-3, 0.015, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0)
            for e in np.arange(-9, 0.5, 1.0)
        ],
    }
    result = {}
    for name, choices in models.items():
        fitted = [model.fit(x0, y0) for model in choices]
        best = min(fitted, key=lambda model: ((model.predict(x1) - y1) ** 2).mean())
        result[name] = float(error(kind, best.predict(x2) + mean, y2 + mean))
    print(json.dumps(result))


if __name__ == "__main__":
    if sys.argv[1] == "make":
        make(Path(sys.argv[2]), int(sys.argv[3]), *map(float, sys.argv[4:]))
    else:
        compare(*sys.argv[2:])

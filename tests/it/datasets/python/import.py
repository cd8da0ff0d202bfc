"""Parquet files as another lab would hand them in, for `palpate dataset import`.

    python tests/it/datasets/python/import.py OUT_DIR

A pad of 208 channels and 100 x 100 mm: OUT_DIR/pad.toml. What must be taken lies in OUT_DIR/good,
what must be refused in OUT_DIR/bad; OUT_DIR/expected.json says of each good file what must come out,
and of each bad one which words its refusal must have.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

CHANNELS, ROWS = 208, 24
SENSOR = 'name = "pad"\nchannels = 208\nwidth_mm = 100\nheight_mm = 100\n'
CONTACT = pa.struct({"x_mm": pa.float64(), "y_mm": pa.float64(), "force_n": pa.float32(), "diameter_mm": pa.float32()})

out = Path(sys.argv[1])
expected: dict[str, dict] = {}
chance = np.random.default_rng(208)


def frames(rows: int = ROWS, channels: int = CHANNELS) -> np.ndarray:
    return chance.normal(0, 0.5, (rows, channels)).astype(np.float32)


def of_frames(values, kind=None) -> pa.Array:
    return pa.array(list(map(list, values)), kind or pa.list_(pa.float32(), CHANNELS))


def everything(row: int) -> list[dict]:
    """None, one, or two contacts."""
    contact = {"x_mm": 20.0 + row, "y_mm": 35.5, "force_n": 4.5 + row / 4, "diameter_mm": 12.0}
    return [contact, {**contact, "x_mm": 80.0}][: row % 3]


def whole(table: pa.Table | pd.DataFrame) -> pa.Table | pd.DataFrame:
    """The table, of untouched skins where it says nothing of contacts."""
    if isinstance(table, pd.DataFrame):
        return table if "contacts" in table else table.assign(contacts=[[]] * len(table))
    if "contacts" in table.column_names:
        return table
    return table.append_column("contacts", pa.array([[]] * len(table), pa.list_(CONTACT)))


def good(name: str, table: pa.Table | pd.DataFrame, **says) -> None:
    """`says`: trials, sums over trials (contacts, missing, null frames), columns left out."""
    path, table = out / "good" / f"{name}.parquet", whole(table)
    table.to_parquet(path) if isinstance(table, pd.DataFrame) else pq.write_table(table, path)
    expected[name] = {"trials": ROWS, "contacts": 0, "missing_channels": 0, "left_out": [], **says}


def bad(name: str, table: pa.Table | bytes, *words: str, as_it_is: bool = False) -> None:
    path = out / "bad" / f"{name}.parquet"
    if isinstance(table, bytes):
        path.write_bytes(table)
    else:
        pq.write_table(table if as_it_is else whole(table), path)
    expected[name] = {"words": words}


def with_contacts(contacts: list, kind=None) -> pa.Table:
    return pa.table({"voltages_v": of_frames(frames(len(contacts))), "contacts": pa.array(contacts, kind or pa.list_(CONTACT))})


def write_good() -> None:
    contacts = [everything(row) for row in range(ROWS)]
    count = sum(map(len, contacts))
    good("pyarrow-whole", pa.table({
        "voltages_v": of_frames(frames()),
        "sim_voltages_v": of_frames(frames()),
        "contacts": pa.array(contacts, pa.list_(CONTACT)),
        "configuration": pa.array([row // 4 for row in range(ROWS)], pa.uint32()),
        "depth_index": pa.array([row % 4 for row in range(ROWS)], pa.uint32()),
        "depth_mm": pa.array([0.5 * (row % 4) for row in range(ROWS)]),
        "tips": pa.array([2] * ROWS, pa.uint8()),
        "flags": pa.array([["unsettled"] if row == 5 else [] for row in range(ROWS)], pa.list_(pa.string())),
        "started_at": pa.array([1_700_000_000_123 + row for row in range(ROWS)], pa.timestamp("ms", "UTC")),
        "temperature_c": pa.array([21.5] * ROWS),
    }), contacts=count, left_out=["temperature_c"])
    good("pyarrow-untouched", pa.table({"voltages_v": of_frames(frames())}))
    good("pyarrow-lists-of-any-length", pa.table({"voltages_v": of_frames(frames(), pa.list_(pa.float64()))}))
    good("pyarrow-large-lists", pa.table({"voltages_v": of_frames(frames(), pa.large_list(pa.float32()))}))
    good("pyarrow-half-floats", pa.table({"voltages_v": of_frames(frames().astype(np.float16), pa.list_(pa.float16()))}))
    # As the example in docs/how-to/datasets.md: contacts without diameter, and none at all.
    good("pyarrow-as-documented", with_contacts([[{"x_mm": 20.0, "y_mm": 35.0, "force_n": 4.9}], []]),
         trials=2, contacts=1)
    no_force = pa.list_(pa.struct({"x_mm": pa.float64(), "y_mm": pa.float64()}))
    good("pyarrow-without-force", with_contacts([[{"x_mm": 5.0, "y_mm": 6.0}], [], [{"x_mm": 0.0, "y_mm": 100.0}]], no_force),
         trials=3, contacts=2)
    good("pyarrow-without-place", with_contacts([[{"force_n": 9.5}], [{"force_n": 3.25}, {"force_n": None}]]),
         trials=2, contacts=3)
    good("pyarrow-contacts-of-nothing", pa.table({"voltages_v": of_frames(frames(3)), "contacts": pa.array([[], [], []])}),
         trials=3)
    values = [[None if channel in (3, 200) else 0.5 for channel in range(CHANNELS)] for _ in range(ROWS)]
    good("pyarrow-null-channels", pa.table({"voltages_v": of_frames(values, pa.list_(pa.float32()))}), missing_channels=2 * ROWS)
    values = frames()
    values[:, 7] = np.nan
    good("pyarrow-nan-channels", pa.table({"voltages_v": of_frames(values)}), missing_channels=ROWS)
    parts = [None if row % 2 else frames(1)[0].tolist() for row in range(ROWS)]
    good("pyarrow-twins-of-half", pa.table({
        "voltages_v": of_frames(frames()), "sim_voltages_v": pa.array(parts, pa.list_(pa.float32())),
    }))
    good("pyarrow-dictionary-flags", pa.table({
        "voltages_v": of_frames(frames()),
        "flags": pa.array([["saturated_channels"]] * ROWS, pa.list_(pa.dictionary(pa.int32(), pa.string()))),
    }))
    good("pandas-whole", pd.DataFrame({
        "voltages_v": list(frames()),
        "contacts": contacts,
        "configuration": np.arange(ROWS),
        "started_at": pd.date_range("2025-03-01", periods=ROWS, freq="s", tz="Europe/Paris"),
        "operator": ["a"] * ROWS,
    }), contacts=count, left_out=["operator"])
    good("pandas-doubles", pd.DataFrame({"voltages_v": [list(map(float, row)) for row in frames()]}))
    # Pandas makes floats of whole numbers where one is missing; configuration then follows the row.
    good("pandas-tips-with-gaps", pd.DataFrame({
        "voltages_v": list(frames(3)), "tips": [1.0, np.nan, 2.0], "depth_mm": [0.5, np.nan, 1.0],
    }), trials=3)


def write_bad() -> None:
    bad("not-parquet", b"PAR1 this is not a table PAR1", "Parquet")
    bad("empty-file", b"", "Parquet")
    bad("no-rows", pa.table({"voltages_v": of_frames([])}), "at least one trial")
    bad("no-voltages", pa.table({"volts": of_frames(frames(2))}), "voltages_v", "volts")
    bad("voltages-of-words", pa.table({"voltages_v": pa.array(["a", "b"])}), "voltages_v", "lists of numbers")
    bad("other-channels", pa.table({"voltages_v": of_frames(frames(2, 104), pa.list_(pa.float32(), 104))}), "row 0, voltages_v", "104", "208", "pad")
    ragged = frames(3).tolist()
    ragged[2] = ragged[2][:-1]
    bad("ragged", pa.table({"voltages_v": of_frames(ragged, pa.list_(pa.float32()))}), "row 2, voltages_v", "207 values", "208")
    bad("null-frame", pa.table({"voltages_v": pa.array([frames(1)[0].tolist(), None], pa.list_(pa.float32()))}), "row 1, voltages_v", "null")
    infinite = frames(2)
    infinite[1, 9] = np.inf
    bad("infinite", pa.table({"voltages_v": of_frames(infinite)}), "row 1, voltages_v", "infinite")
    bad("no-channel-at-all", pa.table({"voltages_v": of_frames(np.full((1, CHANNELS), np.nan))}), "row 0, voltages_v")
    bad("sim-of-other-length", pa.table({"voltages_v": of_frames(frames(2)), "sim_voltages_v": of_frames(frames(2, 9), pa.list_(pa.float32()))}), "row 0, sim_voltages_v", "9 values")
    bad("voltages-alone", pa.table({"voltages_v": of_frames(frames())}), "contacts", "absent", as_it_is=True)
    bad("null-contacts", with_contacts([[], None]), "row 1, contacts", "null", "untouched")
    contact = {"x_mm": 20.0, "y_mm": 35.0, "force_n": 5.0, "diameter_mm": 10.0}
    for name, change, *words in [
        ("contact-off-the-skin", {"x_mm": 100.5}, "x_mm", "100.5", "100"),
        ("contact-below-the-skin", {"y_mm": -1.0}, "y_mm", "-1"),
        ("negative-force", {"force_n": -5.0}, "force_n", "-5"),
        ("infinite-force", {"force_n": float("inf")}, "force_n"),
        ("no-diameter", {"diameter_mm": 0.0}, "diameter_mm", "0"),
        ("half-a-place", {"y_mm": None}, "x_mm and y_mm"),
    ]:
        bad(name, with_contacts([[], [contact, {**contact, **change}]]), "row 1, contacts[1]", *words)
    bad("contacts-of-numbers", with_contacts([[1.0], [2.0]], pa.list_(pa.float64())), "contacts", "x_mm")
    bad("contacts-of-words", with_contacts(["a", "b"], pa.string()), "contacts", "x_mm")
    words_in = pa.list_(pa.struct({"x_mm": pa.string(), "y_mm": pa.string(), "force_n": pa.string()}))
    bad("contacts-in-words", with_contacts([[{"x_mm": "left", "y_mm": "top", "force_n": "hard"}]], words_in), "contacts", "x_mm")
    other = pa.list_(pa.struct({"x": pa.float64(), "y": pa.float64(), "f": pa.float64()}))
    bad("contacts-of-other-names", with_contacts([[{"x": 1.0, "y": 2.0, "f": 3.0}]], other), "contacts", "x_mm")
    bad("many-contacts", with_contacts([[contact] * 300]), "contacts", "300", "64")
    bad("many-contacts-in-one", with_contacts([[contact] * 65, [], []]), "row 0, contacts", "65")
    column = lambda name, values, kind=None: pa.table({"voltages_v": of_frames(frames(len(values))), name: pa.array(values, kind)})
    bad("same-key-twice", column("configuration", [1, 2, 1]), "row 2, configuration", "once")
    bad("negative-configuration", column("configuration", [0, -4]), "row 1, configuration")
    bad("huge-configuration", column("configuration", [0, 2**40]), "row 1, configuration")
    bad("half-a-configuration", column("configuration", [0.5, 1.5]), "configuration", "whole number")
    bad("many-tips", column("tips", [1, 300]), "row 1, tips", "255")
    bad("tips-in-words", column("tips", ["one", "two"]), "tips", "whole numbers")
    bad("infinite-depth", column("depth_mm", [0.5, float("inf")]), "row 1, depth_mm")
    bad("unknown-flag", column("flags", [["wobbly"]], pa.list_(pa.string())), "row 0, flags", "wobbly", "unsettled")
    bad("times-in-words", column("started_at", ["now", "then"]), "started_at", "times")


for folder in ["good", "bad"]:
    (out / folder).mkdir(parents=True, exist_ok=True)
(out / "pad.toml").write_text(SENSOR)
(out / "pad-wrong.toml").write_text('name = "pad"\nchannels = 0\nwidth_mm = -1\nheight_mm = 100\n')
write_good()
write_bad()
(out / "expected.json").write_text(json.dumps(expected, indent=1))
print(f"{len(expected)} files in {out}")

"""The columns that docs/how-to/datasets.md promises, and values in one form, whoever read them."""

import math
from datetime import datetime

import numpy as np
import pandas as pd
import pyarrow as pa

from wire import check

# The columns as docs/how-to/datasets.md promises them: type and unit.
FRAME, CONTACTS = "f32[784]", "contacts"
COLUMNS = {
    "trial_id": ("i64", None), "run": ("text", None), "scan_id": ("i64", None), "seed": ("u64", None),
    "index": ("u64", None), "experiment": ("text", None), "label": ("text", None),
    "configuration": ("u32", None), "depth_index": ("u32", None), "attempt": ("u32", None),
    "depth_mm": ("f64", "mm"), "tips": ("u8", None), "contact_count": ("u8", None),
    "max_force_n": ("f32", "N"), "contacts": (CONTACTS, None), "forces_n": ("f32[6]", "N"),
    "voltages_v": (FRAME, "V"), "sim_voltages_v": (FRAME, "V"), "sim_model": ("text", None),
    "rmse_v": ("f64", "V"), "fvu": ("f64", None), "flags": ("texts", None),
    "saturated_channels": ("u32", None), "stuck_channels": ("u32", None),
    "missing_channels": ("u32", None), "injection_sum_v": ("f64", "V"),
    "dropped_packets": ("u32", None), "depth_error_mm": ("f64", "mm"), "settle_ms": ("f64", "ms"),
    "overshoot_n": ("f64", "N"), "frame_count": ("u32", None), "started_at": ("time", None),
    "measured_at": ("time", None), "split": ("text", None),
}
CONTACT = ["x_mm", "y_mm", "force_n", "diameter_mm"]
ARROW = {
    "i64": pa.int64(), "u64": pa.uint64(), "u32": pa.uint32(), "u8": pa.uint8(), "f64": pa.float64(),
    "f32": pa.float32(), "text": pa.string(), "time": pa.timestamp("ms", "UTC"),
}
SIMULATED = ["sim_voltages_v", "sim_model", "rmse_v", "fvu"]
DRAWN = ["seed", "index"]
WITHOUT = {  # Columns that a dataset has no use for.
    "run-1": [*DRAWN, "split"], "real": [*DRAWN, *SIMULATED], "real-untouched": [*DRAWN, *SIMULATED],
    "r2s-transfer": DRAWN, "s2s-recon": ["voltages_v"],
}


def missing(value) -> bool:
    if value is None or value is pd.NaT or value is pd.NA:
        return True
    return isinstance(value, (float, np.floating)) and math.isnan(value)


def single(value):
    return None if missing(value) else float(np.float32(value))


def double(value):
    return None if missing(value) else float(value)


def milliseconds(value) -> int:
    if isinstance(value, str):
        value = datetime.fromisoformat(value)
    if isinstance(value, np.datetime64):
        return int(value.astype("datetime64[ms]").astype(np.int64))
    return round(value.timestamp() * 1000)


def frame(value):
    if not isinstance(value, np.ndarray) or value.dtype == object:
        value = [math.nan if item is None else item for item in value]
    value = np.asarray(value, np.float32)
    return None if np.isnan(value).all() else value


def plain(column: str, value):
    """A value of a column: None, a number, a text, milliseconds, a tuple, or a frame."""
    kind = COLUMNS[column][0]
    if isinstance(value, float) and math.isnan(value) or value is None or value is pd.NaT:
        return None
    if kind == FRAME:
        return frame(value)
    if kind == CONTACTS:
        of = [double, double, single, single]
        return tuple(tuple(f(c.get(k)) for f, k in zip(of, CONTACT)) for c in value)
    if kind == "f32[6]":
        forces = tuple(single(force) for force in value)
        return None if set(forces) == {None} else forces
    if kind == "texts":
        return tuple(str(text) for text in value)
    if kind == "time":
        return None if str(value) == "NaT" else milliseconds(value)
    if kind == "text":
        return str(value)
    if missing(value):
        return None
    return {"f32": single, "f64": double}.get(kind, int)(value)


def equal(kind: str, a, b) -> bool:
    if kind == FRAME:
        return a is b if a is None or b is None else np.array_equal(a, b, equal_nan=True)
    return a == b


def compare(reader: str, found: dict, expected: list[dict]) -> None:
    """Every value of every column that was read, against the rows that there should be."""
    lengths = {len(values) for values in found.values()}
    if not check(lengths == {len(expected)}, f"{reader}: {lengths} rows, not {len(expected)}"):
        return
    for column, values in found.items():
        for row, (value, wanted) in enumerate(zip(values, expected)):
            value, wanted = plain(column, value), wanted[column]
            if not equal(COLUMNS[column][0], value, wanted):
                at = f"{reader}, {column}, row {row}, trial {expected[row]['trial_id']}"
                check(False, f"{at}: read {str(value)[:120]}, the database says {str(wanted)[:120]}")
                break

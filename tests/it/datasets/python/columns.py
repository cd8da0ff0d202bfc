"""The columns that docs/how-to/datasets.md promises, and values in one form, for every reader."""

import math
import re
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from wire import check

FRAME, CONTACTS = "f32[784]", "contacts"
# Types by their names in the manual.
TYPES = {
    "int64": "i64", "uint64": "u64", "uint32": "u32", "uint8": "u8", "float64": "f64", "float32": "f32",
    "string": "text", "list of string": "texts", "timestamp[ms, UTC]": "time", "float32[784]": FRAME,
    "float32[6]": "f32[6]", "list of struct": CONTACTS,
}


def each(cell: str, columns: list[str]) -> list[str]:
    """The entries of a cell: one per column, or one for all columns."""
    entries = [cell] if cell in TYPES else cell.split(", ")
    if len(entries) == 1:
        entries *= len(columns)
    if len(entries) != len(columns):
        raise SystemExit(f"docs/columns.md: {columns} have {cell}")
    return entries


def promised() -> dict[str, tuple[str, str | None]]:
    """The columns as the manual promises them: type and unit, in order."""
    manual = (Path(__file__).parents[4] / "docs/columns.md").read_text(encoding="utf-8")
    head = "| column | type | unit | |\n|---|---|---|---|\n"
    found = {}
    for line in manual.split(head)[1].split("\n\n")[0].splitlines():
        names, types, units, _ = [cell.strip() for cell in line.strip("|").split("|")]
        names = re.findall("`([a-z_]+)`", names)
        if names == ["force_map_n"]:  # Only with `map`.
            continue
        for name, kind, unit in zip(names, each(types, names), each(units, names)):
            found[name] = (TYPES[kind], None if unit in ("", "1") else unit)
    return found


COLUMNS = promised()
CONTACT = ["x_mm", "y_mm", "force_n", "diameter_mm"]
ARROW = {
    "i64": pa.int64(), "u64": pa.uint64(), "u32": pa.uint32(), "u8": pa.uint8(), "f64": pa.float64(),
    "f32": pa.float32(), "text": pa.string(), "time": pa.timestamp("ms", "UTC"),
}
SIMULATED = ["sim_voltages_v", "sim_model", "rmse_v", "fvu"]
DRAWN = ["seed", "index"]
IMPORTED = ["imported_split", "imported_tag"]
WITHOUT = {  # Columns that a dataset has no use for.
    "run-1": [*DRAWN, "split"], "real": [*DRAWN, *SIMULATED, *IMPORTED],
    "real-untouched": [*DRAWN, *SIMULATED, *IMPORTED], "r2s-transfer": [*DRAWN, *IMPORTED],
    "s2s-recon": ["voltages_v", *IMPORTED],
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

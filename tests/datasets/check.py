"""Datasets of a running service, read as a user reads them, against its database value by value.

    python tests/datasets/check.py URL DATABASE_FILE

Reads with pandas, polars, DuckDB, pyarrow and numpy; the database with sqlite3 alone. Nothing may be
writing trials or twins meanwhile. Exits with 1 and a line for each difference.
"""

import base64
import hashlib
import http.client
import importlib.util
import io
import json
import math
import sqlite3
import sys
import tempfile
import urllib.error
import urllib.parse
import urllib.request
from collections import Counter, defaultdict
from datetime import datetime
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

URL, DATABASE = sys.argv[1].rstrip("/"), Path(sys.argv[2])
DEADBAND_N = 5.0
FORMATS = ["ndjson", "csv", "parquet", "arrow"]

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

faults: list[str] = []


def check(right, words: str) -> bool:
    if not right:
        faults.append(words)
        print(f"WRONG  {words}", flush=True)
    return bool(right)


# --- HTTP ------------------------------------------------------------------------------------------


def get(path: str, method: str = "GET", body: dict | None = None, **headers: str):
    data = None if body is None else json.dumps(body).encode()
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    if data:
        named["Content-Type"] = "application/json"
    request = urllib.request.Request(URL + path, data, named, method=method)
    try:
        with urllib.request.urlopen(request, timeout=120) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers, error.read()
    except http.client.IncompleteRead as error:
        check(False, f"{method} {path}: broke off after {len(error.partial)} bytes")
        return 0, {}, error.partial


def fetched(path: str) -> bytes:
    status, _, body = get(path)
    if status != 200:
        raise SystemExit(f"GET {path}: {status}: {body[:500].decode(errors='replace')}")
    return body


def in_pieces(path: str, piece: int = 100_000) -> bytes:
    whole, tag, length = b"", None, None
    while length is None or len(whole) < length:
        last = len(whole) + piece - 1
        status, headers, body = get(path, Range=f"bytes={len(whole)}-{last}")
        if status != 206 or not body or tag not in (None, headers["ETag"]):
            raise SystemExit(f"GET {path}, Range from {len(whole)}: {status}, {headers['ETag']}")
        tag, length = headers["ETag"], int(headers["Content-Range"].split("/")[1])
        whole += body
    return whole


# --- Values in one form, whoever read them -----------------------------------------------------------


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


# --- Readers: {column: values} -----------------------------------------------------------------------


def of_pandas(table: pd.DataFrame) -> dict:
    return {name: list(table[name]) for name in table.columns}


def of_arrow(table: pa.Table) -> dict:
    return {name: table.column(name).to_pylist() for name in table.column_names}


def of_polars(table: pl.DataFrame) -> dict:
    return {name: table[name].to_list() for name in table.columns}


def of_ndjson(text: bytes, columns: list[str]) -> dict:
    rows = [json.loads(line) for line in text.splitlines()]
    unknown = {key for row in rows for key in row} - set(columns)
    check(not unknown, f"NDJSON has columns {unknown} that Parquet has not")
    return {name: [row.get(name) for row in rows] for name in columns}


def of_csv(text: bytes, columns: list[str]) -> dict:
    table = pd.read_csv(io.BytesIO(text), low_memory=False)
    found, used = {}, 0
    for name in columns:
        items = [c for c in table.columns if c.startswith(f"{name}_") and c[len(name) + 1 :].isdigit()]
        if items:
            check(items == [f"{name}_{n}" for n in range(len(items))], f"CSV: items of {name} out of order")
            found[name] = list(table[items].to_numpy())
        elif COLUMNS[name][0] in (CONTACTS, "texts"):
            found[name] = [None if missing(text) else json.loads(text) for text in table[name]]
        else:
            found[name] = list(table[name])
        used += len(items) or 1
    check(used == len(table.columns), f"CSV: {len(table.columns)} columns, {used} of them known")
    return found


def of_npz(bytes_: bytes) -> dict:
    arrays = np.load(io.BytesIO(bytes_), allow_pickle=False)
    found = {name: list(arrays[name]) for name in arrays.files}
    for name, values in found.items():
        kind = COLUMNS[name][0]
        if kind in ("text", "texts"):
            texts = [None if text == "" else str(text) for text in values]
            found[name] = texts if kind == "text" else [text and json.loads(text) for text in texts]
        if kind == CONTACTS:
            counts = [int(count) for count in arrays["contact_count"]]
            beyond = all(np.isnan(row[count:]).all() for row, count in zip(values, counts))
            check(beyond, "NPZ: contacts go on beyond contact_count")
            found[name] = [[dict(zip(CONTACT, c)) for c in row[:n]] for row, n in zip(values, counts)]
    return found


def duckdb_source(name: str) -> tuple[duckdb.DuckDBPyConnection, str]:
    """What read_parquet can read: the address, or where DuckDB cannot get httpfs, a file in pieces."""
    connection = duckdb.connect()
    path = f"/api/v1/data/{name}.parquet"
    try:
        # From PyPI (duckdb-extension-httpfs) where it is there, else from DuckDB's own server.
        package = importlib.util.find_spec("duckdb_extension_httpfs")
        found = package and next(Path(package.origin).parent.glob("**/httpfs.duckdb_extension"), None)
        connection.execute(f"LOAD '{found}'" if found else "INSTALL httpfs; LOAD httpfs")
        return connection, URL + path
    except duckdb.Error as error:
        print(f"NOTE   DuckDB has no httpfs ({str(error).splitlines()[0][:100]}): reads a file fetched by Range")
        file = Path(tempfile.mkdtemp()) / f"{name}.parquet"
        file.write_bytes(in_pieces(path))
        return connection, str(file)


def arrow_of_duckdb(answer) -> pa.Table:
    table = answer.arrow()
    return table if isinstance(table, pa.Table) else table.read_all()


# --- What there should be ----------------------------------------------------------------------------


def stored_trials(database: sqlite3.Connection) -> list[dict]:
    """Every trial with all columns, contacts by its run's deadband."""
    children = defaultdict(lambda: {"tips": [], "placed": []})
    for tip in database.execute("SELECT * FROM trial_tips ORDER BY trial, arm"):
        children[tip["trial"]]["tips"].append(tip)
    for placed in database.execute("SELECT * FROM placed_contacts ORDER BY trial, n"):
        children[placed["trial"]]["placed"].append(placed)
    trials = database.execute(
        """SELECT t.*, r.uid, r.experiment, r.kind, r.label, r.deadband_n, r.tip_diameter_mm, r.state,
               v.voltages_v, w.rmse_v, w.fvu, m.hash AS sim_model, s.voltages_v AS sim_voltages_v
           FROM trials t JOIN runs r ON r.scan_id = t.run JOIN trial_voltages v ON v.trial = t.id
           LEFT JOIN twins w ON w.trial = t.id
               AND w.model = (SELECT max(model) FROM twins x WHERE x.trial = t.id)
           LEFT JOIN twin_models m ON m.id = w.model
           LEFT JOIN twin_voltages s ON s.trial = t.id AND s.model = w.model ORDER BY t.id"""
    )
    return [trial(row, **children[row["id"]]) for row in trials]


def trial(row: sqlite3.Row, tips: list, placed: list) -> dict:
    found = {name: row[name] for name in COLUMNS if name in row.keys()}
    forces = {tip["arm"]: single(tip["force_n"]) for tip in tips}
    volts = lambda blob: None if blob is None else np.frombuffer(blob, "<f4")
    found |= {
        "trial_id": row["id"], "run": row["uid"], "scan_id": row["run"], "seed": None, "index": None,
        "contacts": labelled(row, tips, placed, row["deadband_n"]),
        "max_force_n": single(row["max_force_n"]), "flags": tuple(json.loads(row["flags"])),
        "forces_n": tuple(forces.get(arm) for arm in range(1, 7)) if forces else None,
        "voltages_v": volts(row["voltages_v"]), "sim_voltages_v": volts(row["sim_voltages_v"]),
        "depth_error_mm": None, "split": None, "kind": row["kind"], "state": row["state"],
        "places": tuple(sorted((round(t["x_mm"], 3), round(t["y_mm"], 3)) for t in tips)),
        "by_deadband": lambda deadband_n: labelled(row, tips, placed, deadband_n),
    }
    if row["reached_z_mm"] is not None and row["target_z_mm"] is not None:
        found["depth_error_mm"] = row["reached_z_mm"] - row["target_z_mm"]
    for time in ["started_at", "measured_at"]:
        found[time] = None if row[time] is None else milliseconds(row[time])
    counted = (found["contact_count"], len(found["contacts"]))
    check(counted[0] == counted[1], f"database, trial {row['id']}: contact_count and contacts are {counted}")
    return found


def labelled(row: sqlite3.Row, tips: list, placed: list, deadband_n: float) -> tuple:
    if row["kind"] == "real-hex":
        rows = [tip for tip in tips if tip["force_n"] >= deadband_n]
        return tuple((t["x_mm"], t["y_mm"], single(t["force_n"]), single(row["tip_diameter_mm"])) for t in rows)
    wide = lambda p: p["diameter_mm"] if p["diameter_mm"] is not None else row["tip_diameter_mm"]
    return tuple((p["x_mm"], p["y_mm"], single(p["force_n"]), single(wide(p))) for p in placed)


def real_hex(trials: list[dict]) -> list[dict]:
    """Trials of ended Real-Hex runs without a flag, labelled with 5 N."""
    rows = []
    for row in trials:
        if row["kind"] == "real-hex" and row["state"] == "ended" and not row["flags"]:
            contacts = row["by_deadband"](DEADBAND_N)
            rows.append({**row, "contacts": contacts, "contact_count": len(contacts)})
    return rows


def sim_random() -> list[dict]:
    """The rows of the shards beside the database."""
    rows = []
    for manifest in sorted(DATABASE.parent.glob("sim-random/*/_manifest.json")):
        for shard in json.loads(manifest.read_text())["shards"]:
            table = pq.read_table(manifest.parent / shard["file"])
            for row in table.to_pylist():
                row = {name: plain(name, row.get(name)) for name in COLUMNS}
                rows.append({**row, "label": "simulated", "places": None, "kind": "sim-random"})
    return rows


def expected_rows(trials: list[dict]) -> dict[str, list[dict]]:
    real = real_hex(trials)
    newest = {row["sim_model"] for row in real} - {None}
    twins = [row for row in real if row["contacts"] and row["sim_voltages_v"] is not None]
    if len(newest) > 1:
        raise SystemExit(f"twins of several models ({newest}): this check knows one")
    return {
        "run-1": [row for row in trials if row["scan_id"] == 1],
        "real": [row for row in real if row["contacts"]],
        "real-untouched": [row for row in real if not row["contacts"]],
        "r2s-transfer": twins,
        "s2s-recon": [*twins, *sim_random()],
    }


# --- Checks ------------------------------------------------------------------------------------------


def check_schema(name: str, schema: pa.Schema) -> None:
    wanted = [column for column in COLUMNS if column not in WITHOUT[name]]
    check(schema.names == wanted, f"{name}: columns {schema.names}, not {wanted}")
    for field in schema:
        kind, unit = COLUMNS[field.name]
        found = (field.metadata or {}).get(b"unit")
        check(found == (unit and unit.encode()), f"{name}, {field.name}: unit {found}, not {unit}")
        if kind in ARROW:
            check(field.type == ARROW[kind], f"{name}, {field.name}: {field.type}, not {ARROW[kind]}")
        elif kind.startswith("f32["):
            length = int(kind[4:-1])
            right = pa.types.is_fixed_size_list(field.type) and field.type.list_size == length
            right = right and field.type.value_type == pa.float32()
            check(right, f"{name}, {field.name}: {field.type}, not {length} float32")
        elif kind == CONTACTS:
            items = [(f.name, str(f.type)) for f in field.type.value_type]
            types = list(zip(CONTACT, ["double", "double", "float", "float"]))
            check(items == types, f"{name}, contacts: {items}, not {types}")


def check_split(name: str, table: dict, expected: list[dict], known: dict) -> None:
    """Parts: shares of 3:1:1, places never on two sides, a trial in one part whatever the dataset."""
    sides, counts, groups = defaultdict(set), Counter(), Counter()
    for row, part in zip(expected, table["split"]):
        row["split"] = part
        if row["places"] is None:
            counts[part] += 1
            continue
        sides[row["places"]].add(part)
        groups[row["places"]] += 1
        before = known.setdefault(row["trial_id"], part)
        check(before == part, f"{name}: trial {row['trial_id']} is in {part}, elsewhere in {before}")
    straddling = [places for places, parts in sides.items() if len(parts) > 1]
    check(not straddling, f"{name}: places {straddling[:2]} are in more than one part")
    counts.update(table["split"][: sum(groups.values())])
    check(set(counts) <= {"train", "validation", "test"}, f"{name}: parts {set(counts)}")
    # The cut falls on the nearest border of a group of the whole table; rows left out shift it.
    total = sum(counts.values())
    if len(groups) >= 20 or not groups:
        slack = 3 * max(groups.values(), default=1) / total + 0.03
        for part, share in {"train": 0.6, "validation": 0.2, "test": 0.2}.items():
            found = counts[part] / total
            check(abs(found - share) <= slack, f"{name}: {part} has {found:.3f} of the rows, not {share} +- {slack:.3f}")
    print(f"       {name}: parts {dict(counts)} in {len(groups)} groups")


def check_formats(name: str, expected: list[dict], known: dict) -> None:
    path = f"/api/v1/data/{name}"
    bytes_ = fetched(f"{path}.parquet")
    table = pq.read_table(io.BytesIO(bytes_))
    check_schema(name, table.schema)
    if "split" in table.column_names:
        check_split(name, of_arrow(table.select(["split"])), expected, known)
    columns = table.column_names
    compare(f"{name}.parquet, pyarrow", of_arrow(table), expected)
    compare(f"{name}.parquet, pandas", of_pandas(pd.read_parquet(f"{URL}{path}.parquet")), expected)
    stream = pa.ipc.open_stream(fetched(f"{path}.arrow")).read_all()
    compare(f"{name}.arrow, pyarrow", of_arrow(stream), expected)
    check(stream.column_names == columns, f"{name}.arrow: other columns than Parquet")
    compare(f"{name}.npz, numpy", of_npz(fetched(f"{path}.npz")), expected)
    compare(f"{name}.csv, pandas", of_csv(fetched(f"{path}.csv"), columns), expected)
    compare(f"{name}.ndjson", of_ndjson(fetched(f"{path}.ndjson"), columns), expected)
    compare(f"{name}.parquet, polars", of_polars(pl.read_parquet(f"{URL}{path}.parquet")), expected)
    lazy = pl.scan_parquet(f"{URL}{path}.parquet")
    compare(f"{name}.parquet, polars, lazy", of_polars(lazy.collect()), expected)
    touched = lazy.filter((pl.col("contact_count") >= 2) & (pl.col("max_force_n") > 10))
    some = ["trial_id", "max_force_n", "contacts", "sim_voltages_v" if name == "s2s-recon" else "voltages_v"]
    over = lambda row: row["contact_count"] >= 2 and row["max_force_n"] is not None and row["max_force_n"] > 10
    rows = [row for row in expected if over(row)]
    compare(f"{name}.parquet, polars, filtered", of_polars(touched.select(some).collect()), rows)
    connection, source = duckdb_source(name)
    order = "ORDER BY trial_id NULLS LAST" + (', seed, "index"' if name == "s2s-recon" else "")
    whole = arrow_of_duckdb(connection.execute(f"SELECT * FROM read_parquet('{source}') {order}"))
    compare(f"{name}.parquet, DuckDB", of_arrow(whole), expected)
    picked = ", ".join(some)
    where = "contact_count >= 2 AND max_force_n > 10"
    answer = connection.execute(f"SELECT {picked} FROM read_parquet('{source}') WHERE {where} {order}")
    compare(f"{name}.parquet, DuckDB, filtered", of_arrow(arrow_of_duckdb(answer)), rows)
    check(in_pieces(f"{path}.parquet") == bytes_, f"{name}.parquet: pieces by Range are other bytes")


def check_http(name: str) -> None:
    for extension in ["parquet", "csv", "npz"]:
        path = f"/api/v1/data/{name}.{extension}"
        status, headers, body = get(path)
        sha256 = hashlib.sha256(body)
        tag = f'"{sha256.hexdigest()}"'
        check(status == 200 and headers["ETag"] == tag, f"GET {path}: {status}, ETag {headers['ETag']}, not {tag}")
        digest = f"sha-256=:{base64.b64encode(sha256.digest()).decode()}:"
        check(headers["Repr-Digest"] == digest, f"GET {path}: Repr-Digest {headers['Repr-Digest']}, not {digest}")
        check(headers["Content-Length"] == str(len(body)), f"GET {path}: Content-Length {headers['Content-Length']}")
        check(headers["Accept-Ranges"] == "bytes", f"GET {path}: Accept-Ranges {headers['Accept-Ranges']}")
        status, again, nothing = get(path, "HEAD")
        same = all(again[h] == headers[h] for h in ["ETag", "Content-Length", "Content-Type", "Repr-Digest"])
        check(status == 200 and same and not nothing, f"HEAD {path}: {status}, {dict(again)}")
        end = len(body) - 1
        for asked, first, last in [("0-9", 0, 9), ("-7", end - 6, end), (f"{end}-", end, end), ("3-99999999999", 3, end)]:
            status, part, piece = get(path, Range=f"bytes={asked}")
            right = status == 206 and piece == body[first : last + 1]
            right = right and part["Content-Range"] == f"bytes {first}-{last}/{len(body)}" and part["ETag"] == tag
            check(right, f"GET {path}, Range {asked}: {status}, {part['Content-Range']}, {len(piece)} bytes")
        status, part, _ = get(path, Range=f"bytes={end + 1}-")
        check(status == 416, f"GET {path}, Range past its end: {status}, not 416")
        check(part["Content-Range"] == f"bytes */{end + 1}", f"GET {path}, 416: Content-Range {part['Content-Range']}")
        for known in [tag, f'"other", {tag}', f"W/{tag}", "*"]:
            status, _, nothing = get(path, If_None_Match=known)
            check(status == 304 and not nothing, f"GET {path}, If-None-Match {known}: {status}, not 304")
        status, _, again = get(path, If_None_Match='"other"')
        check(status == 200 and again == body, f"GET {path}, If-None-Match of another: {status}, not 200")
        status, _, piece = get(path, Range="bytes=5-14", If_Range=tag)
        check(status == 206 and piece == body[5:15], f"GET {path}, If-Range with its tag: {status}, not 206")
        status, _, again = get(path, Range="bytes=5-14", If_Range='"other"')
        check(status == 200 and again == body, f"GET {path}, If-Range of another: {status}, not 200 and all of it")
    row = json.loads(fetched(f"/api/v1/datasets/{name}"))
    body = fetched(row["url"])
    check(hashlib.sha256(body).hexdigest() == row["sha256"], f"{name}: sha256 in /datasets is not the file's")
    check(len(body) == row["bytes"], f"{name}: {row['bytes']} bytes in /datasets, {len(body)} in the file")
    check(row["url"] == f"/api/v1/data/{row['id']}.parquet", f"{name}: url {row['url']}")
    status, headers, _ = get(row["url"])
    check("immutable" in headers["Cache-Control"], f"{row['url']}: Cache-Control {headers['Cache-Control']}")


def pages(path: str, form: str | None, limit: int):
    """Bodies of all pages; `form` None is JSON."""
    cursor = None
    while True:
        asked = f"{path}{'&' if '?' in path else '?'}limit={limit}"
        asked += (f"&format={form}" if form else "") + (f"&cursor={cursor}" if cursor else "")
        status, headers, body = get(asked)
        if not check(status == 200, f"GET {asked}: {status} {body[:300]!r}"):
            return
        body = json.loads(body) if form is None else body
        yield body
        cursor = body.get("next") if form is None else headers["x-next-cursor"]
        if cursor is None:
            return


def read_page(form: str, body: bytes, columns: list[str]) -> dict:
    if form == "parquet":
        return of_arrow(pq.read_table(io.BytesIO(body)))
    if form == "arrow":
        return of_arrow(pa.ipc.open_stream(body).read_all())
    return (of_csv if form == "csv" else of_ndjson)(body, columns)


def joined(form: str, bodies, columns: list[str]) -> dict:
    found = {name: [] for name in columns}
    for body in bodies:
        for name, values in read_page(form, body, columns).items():
            found[name] += values
    return found


def check_pages(expected: dict[str, list[dict]], trials: list[dict]) -> None:
    for name in ["run-1", "real"]:
        columns = [column for column in COLUMNS if column not in WITHOUT[name]]
        path = f"/api/v1/datasets/{name}/rows"
        rows = [row for page in pages(path, None, 50) for row in page["rows"]]
        compare(f"{path}, JSON", {c: [row.get(c) for row in rows] for c in columns}, expected[name])
        for form in FORMATS:
            compare(f"{path}, {form}", joined(form, pages(path, form, 70), columns), expected[name])
        some = ["trial_id", "contact_count", "max_force_n", "started_at"]
        where = "contact_count__gte=1&max_force_n__gt=12.5&columns=" + ",".join(some)
        rows = [row for page in pages(f"{path}?{where}", None, 7) for row in page["rows"]]
        wanted = [row for row in expected[name] if row["contact_count"] >= 1 and row["max_force_n"] > 12.5]
        compare(f"{path}?{where}", {c: [row.get(c) for row in rows] for c in some}, wanted)
        check(all(set(row) <= set(some) for row in rows), f"{path}?{where}: other columns than asked for")
    check_stored(expected, trials)


def check_stored(expected: dict[str, list[dict]], trials: list[dict]) -> None:
    everything = [column for column in COLUMNS if column not in [*DRAWN, "split"]]
    path = "/api/v1/trials?voltages=true"
    if len({len(row["voltages_v"]) for row in trials}) > 1:
        status, _, body = get(f"{path}&limit=10000&format=arrow")
        check(status == 409, f"{path}, arrow, skins of several lengths: {status}, {len(body)} bytes")
        path, trials = "/api/v1/runs/1/trials?voltages=true", expected["run-1"]
    rows = [row for page in pages(path, None, 50) for row in page["trials"]]
    # JSON has no depth_error_mm: it has target and reached.
    asked = [column for column in everything if column != "depth_error_mm"]
    compare(f"{path}, JSON", {c: [row.get(c) for row in rows] for c in asked}, trials)
    for form in FORMATS:
        compare(f"{path}, {form}", joined(form, pages(path, form, 70), everything), trials)
    path = "/api/v1/runs/1/trials"
    few = [column for column in everything if not column.endswith("voltages_v")]
    for form in FORMATS:
        compare(f"{path}, {form}", joined(form, pages(path, form, 1000), few), expected["run-1"])
    path = "/api/v1/runs/1/trials?sort=-trial_id"
    compare(f"{path}, arrow", joined("arrow", pages(path, "arrow", 60), few), expected["run-1"][::-1])
    where = "contact_count=3&max_force_n__gt=10&columns=trial_id,voltages_v"
    wanted = [row for row in expected["run-1"] if row["contact_count"] == 3 and (row["max_force_n"] or 0) > 10]
    path = f"/api/v1/runs/1/trials?{where}"
    for form in ["arrow", "parquet"]:
        compare(f"{path}, {form}", joined(form, pages(path, form, 9), ["trial_id", "voltages_v"]), wanted)
    page = json.loads(fetched(f"{path}&limit=10000"))["trials"]
    compare(f"{path}, JSON", {c: [row.get(c) for row in page] for c in ["trial_id", "voltages_v"]}, wanted)


def check_slices_and_maps(expected: dict[str, list[dict]]) -> None:
    rows = expected["real"]
    cut = [{**row, "voltages_v": row["voltages_v"][28:84]} for row in rows]
    path = "/api/v1/data/real.parquet?slice=28:84&columns=trial_id,voltages_v"
    compare(path, of_arrow(pq.read_table(io.BytesIO(fetched(path)))), cut)
    path = "/api/v1/datasets/real/rows?slice=28:84&columns=trial_id,voltages_v"
    compare(f"{path}, arrow", joined("arrow", pages(path, "arrow", 100), ["trial_id", "voltages_v"]), cut)
    stored = [{**row, "voltages_v": row["voltages_v"][:28]} for row in expected["run-1"][:20]]
    path = "/api/v1/runs/1/trials?slice=0:28&columns=trial_id,voltages_v&voltages=true&limit=20"
    table = pa.ipc.open_stream(fetched(path + "&format=arrow")).read_all()
    compare(f"{path}, arrow", of_arrow(table), stored)
    page = json.loads(fetched(path))["trials"]
    compare(f"{path}, JSON", {c: [row.get(c) for row in page] for c in ["trial_id", "voltages_v"]}, stored)
    for text in ["20x60", "4x20", "10x10"]:
        path = f"/api/v1/data/real.npz?map={text}&columns=trial_id,contact_count"
        arrays = np.load(io.BytesIO(fetched(path)), allow_pickle=False)
        pixel, maps = float(text.split("x")[0]), arrays["force_map_n"].astype(np.float64)
        side = round(640 / pixel)
        if not check(maps.shape == (len(rows), side * side), f"{path}: maps of shape {maps.shape}"):
            continue
        worst = 0.0
        for row, pixels in zip(rows, maps):
            contacts = np.array(row["contacts"], float)
            force = contacts[:, 2].sum()
            worst = max(worst, abs(pixels.sum() - force) / force)
            # Rows go up y from -40 mm, columns up x from -50 mm (a 540 x 560 mm skin).
            centres = (np.arange(side) + 0.5) * pixel
            square = pixels.reshape(side, side)
            mean = np.array([square.sum(0) @ (centres - 50), square.sum(1) @ (centres - 40)]) / force
            apart = np.abs(mean - (contacts[:, :2] * contacts[:, 2:3]).sum(0) / force).max()
            if not check(apart < pixel / 2, f"{path}, trial {row['trial_id']}: {apart:.1f} mm off its contacts"):
                break
        # A pixel is an f32: half an ulp, 6e-8 of it, and as much for each contact that adds to it.
        check(worst < 1e-6, f"{path}: a map sums to its forces but for {worst:.1e}")
        print(f"       map {text}: sums to its forces but for {worst:.1e}")


BAD = [  # Address, status, words that the body must have.
    ("/api/v1/datasets/real/rows?colour=red", 400, ["colour", "contact_count"]),
    ("/api/v1/datasets/real/rows?columns=colour", 400, ["colour", "contact_count"]),
    ("/api/v1/datasets/real/rows?columns=seed", 400, ["seed", "contact_count"]),
    ("/api/v1/datasets/real/rows?rmse_v__gt=1", 400, ["rmse_v", "contact_count"]),
    ("/api/v1/datasets/real/rows?contact_count__gt=many", 400, ["contact_count", "many", "number"]),
    ("/api/v1/datasets/real/rows?contact_count__near=3", 400, ["near", "gte"]),
    ("/api/v1/datasets/real/rows?voltages_v__gt=1", 400, ["voltages_v", "contact_count"]),
    ("/api/v1/datasets/real/rows?contacts=1", 400, ["contacts", "contact_count"]),
    ("/api/v1/datasets/real/rows?started_at__gt=yesterday", 400, ["started_at", "3339"]),
    ("/api/v1/datasets/real/rows?split__gt=train", 400, ["split", "eq"]),
    ("/api/v1/datasets/real/rows?map=3x20", 400, ["map", "640"]),
    ("/api/v1/datasets/real/rows?map=1x20", 400, ["map", "160"]),
    ("/api/v1/datasets/real/rows?map=4x0", 400, ["map", "diameter"]),
    ("/api/v1/datasets/real/rows?map=4x1000", 400, ["map", "320"]),
    ("/api/v1/datasets/real/rows?map=nanxnan", 400, ["map"]),
    ("/api/v1/datasets/real/rows?map=fine", 400, ["map", "4x20"]),
    ("/api/v1/datasets/real/rows?limit=1000000", 400, ["limit", "10000", "export"]),
    ("/api/v1/datasets/real/rows?limit=0", 400, ["limit"]),
    ("/api/v1/datasets/real/rows?limit=-1", 400, ["limit"]),
    ("/api/v1/datasets/real/rows?cursor=first", 400, ["cursor"]),
    ("/api/v1/datasets/real/rows?format=xlsx", 400, ["format", "parquet", "json"]),
    ("/api/v1/datasets/real/rows?format=npz", 400, ["format", "parquet"]),
    ("/api/v1/datasets/real/rows?slice=700:785", 400, ["slice", "784"]),
    ("/api/v1/datasets/real/rows?slice=5:5", 400, ["slice", "784"]),
    ("/api/v1/datasets/real/rows?slice=28", 400, ["slice", "784"]),
    ("/api/v1/data/real.parquet?columns=colour", 400, ["colour", "contact_count"]),
    ("/api/v1/data/real.csv?map=3x20", 400, ["map", "640"]),
    ("/api/v1/data/real.parquet?tips__gt=many", 400, ["tips", "many"]),
    ("/api/v1/data/real.parquet?limit=10", 400, ["limit"]),
    ("/api/v1/data/real.parquet?cursor=10", 400, ["cursor"]),
    ("/api/v1/data/real.parquet?format=csv", 400, ["format"]),
    ("/api/v1/data/real.xlsx", 404, ["xlsx", "parquet"]),
    ("/api/v1/data/real", 404, ["parquet"]),
    ("/api/v1/data/nothing.parquet", 404, ["nothing", "r2s-transfer"]),
    ("/api/v1/data/ds-0000000000000000.parquet", 404, ["ds-0000000000000000"]),
    ("/api/v1/data/run-99.parquet", 404, ["run-99"]),
    ("/api/v1/datasets/nothing", 404, ["nothing", "r2s-transfer"]),
    ("/api/v1/datasets/nothing/rows", 404, ["nothing"]),
    ("/api/v1/datasets/..%2f..%2fpalpate/rows", 404, []),
    ("/api/v1/data/..%2f..%2fpalpate.parquet", 404, []),
    ("/api/v1/trials?colour=red", 400, ["colour", "contact_count"]),
    ("/api/v1/trials?columns=colour", 400, ["colour", "contact_count"]),
    ("/api/v1/trials?columns=split&format=arrow", 400, ["split", "contact_count"]),
    ("/api/v1/trials?tips=many", 400, ["tips", "many", "number"]),
    ("/api/v1/trials?max_force_n__gt=nan", 400, ["max_force_n", "nan"]),
    ("/api/v1/trials?columns=split", 400, ["split", "contact_count"]),
    ("/api/v1/trials?voltages_v__gt=1", 400, ["voltages_v", "contact_count"]),
    ("/api/v1/trials?limit=1000000", 400, ["limit", "10000"]),
    ("/api/v1/trials?format=xlsx", 400, ["format", "parquet", "json"]),
    ("/api/v1/trials?format=npz", 400, ["format", "parquet"]),
    ("/api/v1/trials?slice=0:785&voltages=true&format=arrow", 400, ["slice", "784"]),
    ("/api/v1/trials?slice=0:785&voltages=true", 400, ["slice", "784"]),
    ("/api/v1/trials?voltages=perhaps", 400, ["voltages", "true"]),
    ("/api/v1/trials?cursor=x", 400, ["cursor"]),
    ("/api/v1/trials?sort=colour", 400, ["sort", "-trial_id"]),
    ("/api/v1/trials?flag=colour", 400, ["flag", "unsettled"]),
    ("/api/v1/runs/99/trials?format=csv", 404, ["99"]),
]
BAD_EXPORTS = [
    ({"dataset": "real", "format": "xlsx"}, {400, 422}, ["xlsx", "parquet"]),
    ({"dataset": "nothing", "format": "csv"}, {404}, ["nothing"]),
    ({"dataset": "real", "format": "csv", "map": "3x20"}, {400}, ["map", "640"]),
    ({"dataset": "real", "format": "csv", "columns": ["colour"]}, {400}, ["colour", "contact_count"]),
    ({"dataset": "real", "format": "csv", "where": ["colour=red"]}, {400}, ["colour", "contact_count"]),
    ({"dataset": "real", "format": "csv", "colour": 1}, {400, 422}, ["colour"]),
]


def check_refusals() -> None:
    asked = [(f"GET {path}", get(path), {status}, words) for path, status, words in BAD]
    posted = lambda body: get("/api/v1/exports", "POST", body)
    asked += [(f"POST /api/v1/exports {body}", posted(body), status, words) for body, status, words in BAD_EXPORTS]
    for what, (status, headers, body), allowed, words in asked:
        text = body[:2000].decode(errors="replace")
        if not check(status in allowed, f"{what}: {status}, not {allowed}: {text[:200]}"):
            continue
        kind = headers["Content-Type"]
        check(kind == "application/problem+json", f"{what}: Content-Type {kind}")
        lacking = [word for word in words if word not in text]
        check(not lacking, f"{what}: the body does not say {lacking}: {text[:300]}")


def main() -> None:
    database = sqlite3.connect(f"file:{urllib.parse.quote(str(DATABASE))}?mode=ro", uri=True)
    database.row_factory = sqlite3.Row
    trials = stored_trials(database)
    expected = expected_rows(trials)
    known: dict = {}
    for name, rows in expected.items():
        if not rows:
            check(get(f"/api/v1/data/{name}.parquet")[0] == 404, f"{name} has no rows and is not a 404")
            continue
        print(f"{name}: {len(rows)} rows in every format", flush=True)
        check_formats(name, rows, known)
    print("ranges and tags", flush=True)
    check_http("real")
    print("pages", flush=True)
    check_pages(expected, trials)
    print("slices and force maps", flush=True)
    check_slices_and_maps(expected)
    print("refusals", flush=True)
    check_refusals()
    print(f"{len(faults)} wrong" if faults else "all equal")
    sys.exit(1 if faults else 0)


main()

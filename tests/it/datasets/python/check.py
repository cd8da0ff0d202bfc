"""Datasets of a running service, read as a user reads them, against its database value by value.

    python tests/it/datasets/python/check.py URL DATABASE_FILE

Reads with pandas, polars, DuckDB, pyarrow and numpy; the database with sqlite3 alone. Nothing may be
writing trials or twins meanwhile. Exits with 1 and a line for each difference.
"""

import base64
import hashlib
import io
import json
import re
import sqlite3
import sys
import urllib.parse
from collections import Counter, defaultdict

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from wire import DATABASE, URL, check, faults, fetched, get, in_pieces
from columns import ARROW, COLUMNS, CONTACT, CONTACTS, DRAWN, WITHOUT, compare
from readers import arrow_of_duckdb, duckdb_source, of_arrow, of_csv, of_ndjson, of_npz, of_pandas, of_polars
from expected import expected_rows, stored_trials
from refusals import check_refusals

FORMATS = ["ndjson", "csv", "parquet", "arrow"]


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
    stream = pa.ipc.open_stream(fetched(f"{path}.arrows")).read_all()
    file = pa.ipc.open_file(fetched(f"{path}.arrow")).read_all()
    assert file.equals(stream), "the file and the stream differ"
    compare(f"{name}.arrow, pyarrow", of_arrow(stream), expected)
    check(stream.column_names == columns, f"{name}.arrow: other columns than Parquet")
    compare(f"{name}.arrow, pandas", of_pandas(pd.read_feather(f"{URL}{path}.arrow")), expected)
    compare(f"{name}.arrow, polars, lazy", of_polars(pl.scan_ipc(f"{URL}{path}.arrow").collect()), expected)
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


def next_of(link: str | None) -> str | None:
    """The cursor in the address of the next page, of the header Link."""
    return link and re.fullmatch(r'<[^>]*[?&]cursor=([^&>]+)[^>]*>; rel="next"', link)[1]


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
        cursor = body.get("next") if form is None else next_of(headers["Link"])
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
        rows = [row for page in pages(path, None, 50) for row in page["items"]]
        compare(f"{path}, JSON", {c: [row.get(c) for row in rows] for c in columns}, expected[name])
        for form in FORMATS:
            compare(f"{path}, {form}", joined(form, pages(path, form, 70), columns), expected[name])
        some = ["trial_id", "contact_count", "max_force_n", "started_at"]
        where = "contact_count__gte=1&max_force_n__gt=12.5&columns=" + ",".join(some)
        rows = [row for page in pages(f"{path}?{where}", None, 7) for row in page["items"]]
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
    rows = [row for page in pages(path, None, 50) for row in page["items"]]
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
        check(worst < 1e-6, f"{path}: a map sums to its forces except for {worst:.1e}")
        print(f"       map {text}: sums to its forces except for {worst:.1e}")


def main() -> None:
    database = sqlite3.connect(f"file:{urllib.parse.quote(str(DATABASE))}?mode=ro", uri=True)
    database.row_factory = sqlite3.Row
    trials = stored_trials(database)
    expected = expected_rows(trials)
    known: dict = {}
    for name, rows in expected.items():
        made = get("/api/v1/datasets", "POST", {"name": name})[0]
        if not rows:
            check(made == 404 == get(f"/api/v1/data/{name}.parquet")[0], f"{name} has no rows and is not a 404")
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

"""Tables of every reader as {column: values}."""

import importlib.util
import io
import json
import tempfile
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa

from wire import URL, check, in_pieces
from columns import COLUMNS, CONTACT, CONTACTS, missing


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
            check(beyond, "NPZ: contacts continue beyond contact_count")
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

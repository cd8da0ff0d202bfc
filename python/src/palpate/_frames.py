"""Answers of the service as tables of polars, pandas or Arrow.

Uses: the library of the table, imported when it is first needed. Never: a request.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

F = TypeVar("F")
F_co = TypeVar("F_co", covariant=True)

MAP = "force_map_n"
# Columns of the lists of runs, events and datasets; the JSON of the service has more about each.
RUNS: dict[str, type] = {
    "scan_id": int, "uid": str, "experiment": str, "kind": str, "label": str, "state": str,
    "exit_status": str, "reason": str, "is_resumable": bool, "trials_planned": int, "deadband_n": float, "seed": int,
    "created_at": datetime, "started_at": datetime, "ended_at": datetime, "submitted_by": str,
}  # fmt: skip
EVENTS: dict[str, type] = {
    "seq": int, "run": str, "at": datetime, "kind": str, "importance": str, "words": str, "data": str,
}  # fmt: skip
DATASETS: dict[str, type] = {
    "name": str, "id": str, "rows": int, "bytes": int, "sha256": str, "created_at": datetime,
}  # fmt: skip
TABLES: dict[str, type] = {"name": str, "about": str}


class Frames(Protocol[F_co]):
    """How a library makes a table."""

    def of_streams(self, streams: Sequence[bytes], side: int | None) -> F_co:
        """The rows of Arrow streams, one after the other; force maps of ``side`` x ``side`` pixels."""

    def of_parquet(self, file: bytes) -> F_co:
        """The rows of a Parquet file."""

    def of_items(self, items: Sequence[dict[str, Any]], kinds: dict[str, type]) -> F_co:
        """The items of JSON pages, with these columns."""


class Polars:
    """Tables of polars."""

    def of_streams(self, streams: Sequence[bytes], side: int | None) -> pl.DataFrame:
        """See ``Frames``."""
        polars = needed("polars")
        tables = [polars.read_ipc_stream(io.BytesIO(stream)) for stream in streams]
        # Frames of skins with different numbers of channels become lists.
        for name in {name for table in tables for name in table.columns}:
            kinds = {table.schema[name] for table in tables if name in table.columns}
            if len(kinds) > 1 and all(isinstance(kind, polars.Array) for kind in kinds):
                tables = [_lists(table, name) if name in table.columns else table for table in tables]
        table: pl.DataFrame = polars.concat(tables, how="diagonal_relaxed") if len(tables) > 1 else tables[0]
        if side is not None and MAP in table.columns:
            table = table.with_columns(table[MAP].reshape((-1, side, side)))
        return table

    def of_parquet(self, file: bytes) -> pl.DataFrame:
        """See ``Frames``."""
        table: pl.DataFrame = needed("polars").read_parquet(io.BytesIO(file))
        return table

    def of_items(self, items: Sequence[dict[str, Any]], kinds: dict[str, type]) -> pl.DataFrame:
        """See ``Frames``."""
        polars = needed("polars")
        of_type = {
            int: polars.Int64, float: polars.Float64, str: polars.String, bool: polars.Boolean,
            datetime: polars.Datetime("ms", "UTC"),
        }  # fmt: skip
        schema = {name: of_type[kind] for name, kind in kinds.items()}
        table: pl.DataFrame = polars.DataFrame(_values(items, kinds), schema=schema)
        return table


class Arrow:
    """Tables of Arrow."""

    def of_streams(self, streams: Sequence[bytes], side: int | None) -> pa.Table:
        """See ``Frames``."""
        pyarrow = needed("pyarrow")
        tables = [needed("pyarrow.ipc").open_stream(stream).read_all() for stream in streams]
        for name in {name for table in tables for name in table.column_names}:
            kinds = {table.schema.field(name).type for table in tables if name in table.column_names}
            if len(kinds) > 1 and all(pyarrow.types.is_fixed_size_list(kind) for kind in kinds):
                kind = pyarrow.list_(next(iter(kinds)).value_type)
                tables = [_cast(table, name, kind) for table in tables]
        table = pyarrow.concat_tables(tables, promote_options="permissive")
        if side is not None and MAP in table.column_names:
            kind = pyarrow.fixed_shape_tensor(pyarrow.float32(), (side, side))
            chunks = [pyarrow.ExtensionArray.from_storage(kind, chunk) for chunk in table[MAP].chunks]
            place = table.schema.get_field_index(MAP)
            table = table.set_column(place, MAP, pyarrow.chunked_array(chunks, kind))
        return table

    def of_parquet(self, file: bytes) -> pa.Table:
        """See ``Frames``."""
        return needed("pyarrow.parquet").read_table(io.BytesIO(file))

    def of_items(self, items: Sequence[dict[str, Any]], kinds: dict[str, type]) -> pa.Table:
        """See ``Frames``."""
        pyarrow = needed("pyarrow")
        of_type = {
            int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string(),
            bool: pyarrow.bool_(), datetime: pyarrow.timestamp("ms", "UTC"),
        }  # fmt: skip
        schema = pyarrow.schema([(name, of_type[kind]) for name, kind in kinds.items()])
        return pyarrow.table(_values(items, kinds), schema=schema)


class Pandas:
    """Tables of pandas. A frame is an array in its cell, and so is a force map, with its shape."""

    def of_streams(self, streams: Sequence[bytes], side: int | None) -> pd.DataFrame:
        """See ``Frames``."""
        needed("pandas")
        table = Arrow().of_streams(streams, None).to_pandas()
        if side is not None and MAP in table.columns:
            table[MAP] = [flat.reshape(side, side) for flat in table[MAP]]
        return table

    def of_parquet(self, file: bytes) -> pd.DataFrame:
        """See ``Frames``."""
        needed("pandas")
        return Arrow().of_parquet(file).to_pandas()

    def of_items(self, items: Sequence[dict[str, Any]], kinds: dict[str, type]) -> pd.DataFrame:
        """See ``Frames``."""
        needed("pandas")
        return Arrow().of_items(items, kinds).to_pandas()


def needed(module: str) -> Any:
    """A module that is not installed with this package, imported by name.

    Raises ``ImportError`` with the command that installs it.
    """
    import importlib

    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.partition(".")[0]:
            raise
        raise ImportError(f"this needs {error.name}: pip install {error.name}") from error


def _lists(table: pl.DataFrame, name: str) -> pl.DataFrame:
    """Fixed-size frames as lists."""
    return table.with_columns(table[name].arr.to_list())


def _cast(table: pa.Table, name: str, kind: pa.DataType) -> pa.Table:
    if name not in table.column_names:
        return table
    place = table.schema.get_field_index(name)
    return table.set_column(place, name, table[name].cast(kind))


def _values(items: Sequence[dict[str, Any]], kinds: dict[str, type]) -> dict[str, list[Any]]:
    return {name: [_value(item.get(name), kind) for item in items] for name, kind in kinds.items()}


def _value(value: Any, kind: type) -> Any:
    """A value of JSON as a column of this type holds it; an object becomes its text."""
    if value is None:
        return None
    if kind is datetime:
        # Python 3.10 reads no Z and no fractions of two digits.
        whole, _, fraction = str(value).removesuffix("Z").partition(".")
        milliseconds = int(fraction.ljust(3, "0")[:3] or 0)
        at = datetime.fromisoformat(whole).replace(tzinfo=timezone.utc)
        return at.replace(microsecond=1000 * milliseconds)
    if kind is str and not isinstance(value, str):
        return json.dumps(value)
    return kind(value)

"""``Palpate``: the questions that a lab asks its service.

Uses: the service, tables. Never: a request that changes anything.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from palpate._dataset import PAGE_ROWS, Dataset, names_frames, page_rows
from palpate._frames import DATASETS, EVENTS, RUNS, TABLES, Arrow, F, Frames, Pandas, Polars
from palpate._http import Service
from palpate._select import Condition, selection

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

G = TypeVar("G")
# Entries of a page of runs, events or datasets.
ITEMS = 1000


class Palpate(Generic[F]):
    """A service. Tables are polars; ``Palpate().pandas()`` is the same service with pandas tables.

    ``url``: default ``PALPATE_URL``, then ``http://127.0.0.1:8080``.
    ``key``: default ``PALPATE_KEY``, then the content of the file ``PALPATE_KEY_FILE``.
    ``ca``: PEM file with the certificate of a service with TLS; default ``PALPATE_CA``.
    ``timeout_s``: longest silence of the service.
    ``wait_s``: longest time that a request is repeated while the service answers that it is busy,
    or that its query engine is being built (with a line on stderr).

    Raises ``PalpateError`` from each method, if the service refuses a request or none answers.
    """

    _service: Service
    _frames: Frames[F]

    def __init__(
        self: Palpate[pl.DataFrame],
        url: str | None = None,
        key: str | None = None,
        *,
        ca: str | os.PathLike[str] | None = None,
        timeout_s: float = 120.0,
        wait_s: float = 1200.0,
    ) -> None:
        self._service = Service(url, key, ca, timeout_s, wait_s)
        self._frames = Polars()

    def __repr__(self) -> str:
        return f"Palpate({self._service.url!r})"

    def pandas(self) -> Palpate[pd.DataFrame]:
        """The same service, with tables of pandas."""
        return self._with(Pandas())

    def polars(self) -> Palpate[pl.DataFrame]:
        """The same service, with tables of polars (the default)."""
        return self._with(Polars())

    def arrow(self) -> Palpate[pa.Table]:
        """The same service, with tables of Arrow."""
        return self._with(Arrow())

    def sql(self, statement: str) -> F:
        """The rows of a SELECT statement over the tables of ``tables()``."""
        return self._frames.of_streams([self._service.query(statement).body], None)

    def tables(self) -> F:
        """The tables of ``sql``, and what a row of each is."""
        return self._frames.of_items(self._service.get("/query/tables").json(), TABLES)

    def trials(
        self,
        *,
        run: int | str | None = None,
        columns: Iterable[str] | None = None,
        voltages: bool | None = None,
        slice: str | None = None,
        flag: str | None = None,
        flagged: bool | None = None,
        newest_first: bool = False,
        limit: int | None = None,
        **conditions: Condition,
    ) -> F:
        """The trials that are stored at this moment, of all runs or of one, to the last page.

        ``run``: number or id. ``columns``: only these, in this order. ``voltages``: with measured and
        simulated frames; ``slice="0:28"``: these values of each. ``flag``, ``flagged``: only with this
        flag, with or without any. ``limit``: at most this number of trials.
        Any other name is a condition on a column: ``tips=4``, ``max_force_n__gt=10``,
        ``tips=[1, 4]``; with gt, gte, lt, lte and in.
        """
        path = "/trials" if run is None else f"/runs/{run}/trials"
        parameters = selection(conditions, columns, slice)
        parameters |= {"voltages": voltages, "flag": flag, "flagged": flagged, "format": "arrow"}
        parameters |= {"sort": "-trial_id" if newest_first else None}
        rows = page_rows(PAGE_ROWS, bool(voltages) or names_frames(str(parameters["columns"])))
        most = rows if limit is None else min(limit, rows)
        page = self._service.get(path, parameters | {"limit": most})
        pages = [page.body]
        while page.next_path and (limit is None or len(pages) * rows < limit):
            page = self._service.follow(page.next_path)
            pages.append(page.body)
        table = self._frames.of_streams(pages, None)
        return cast(F, cast(Any, table)[:limit]) if limit and limit > rows else table

    def runs(self) -> F:
        """The runs, newest first."""
        return self._frames.of_items(self._items("/runs"), RUNS)

    def run(self, run: int | str) -> dict[str, Any]:
        """What the service states about a run: the texts of its files, its states, its times."""
        found: dict[str, Any] = self._service.get(f"/runs/{run}").json()
        return found

    def events(
        self, *, run: int | str | None = None, kind: str | Iterable[str] | None = None, since: int | None = None
    ) -> F:
        """The events, oldest first: of a run, of these kinds, after the one of this number.

        A negative number counts from the end of the selected events. Their data is a text of JSON, their words
        are a sentence.
        """
        kinds = kind if kind is None or isinstance(kind, str) else ",".join(kind)
        return self._frames.of_items(self._items("/events", run=run, kind=kinds, since=since), EVENTS)

    def datasets(self) -> F:
        """The datasets, newest first."""
        return self._frames.of_items(self._items("/datasets"), DATASETS)

    def dataset(self, name: str) -> Dataset:
        """A dataset by its name or id."""
        return Dataset(self._service, name)

    def get(self, path: str, **parameters: str | int | float | bool | None) -> Any:
        """The JSON of any other path below ``/api/v1``, such as ``get("/runs/1/summary")``."""
        return self._service.get(path, parameters).json()

    def _items(self, path: str, **parameters: str | int | None) -> list[dict[str, Any]]:
        """The items of all JSON pages."""
        items: list[dict[str, Any]] = []
        cursor: str | None = None
        while True:
            page = self._service.get(path, {**parameters, "limit": ITEMS, "cursor": cursor}).json()
            items += page["items"]
            cursor = page.get("next")
            if cursor is None:
                return items

    def _with(self, frames: Frames[G]) -> Palpate[G]:
        other: Palpate[G] = object.__new__(Palpate)
        other._service, other._frames = self._service, frames
        return other

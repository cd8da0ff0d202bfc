"""A dataset: rows that never change, read in the form that is asked for.

Uses: the service, tables. Never: another dataset than the one that its name stood for at first.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate._frames import MAP, Arrow, F, Frames, Pandas, Polars, needed
from palpate._http import PREFIX, Parameters, Service, address
from palpate._select import Condition, map_side, selection

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    from palpate._torch import TrialDataset

PAGE_ROWS = 10_000
# Numbers in the frames and maps of a page; the service refuses more than 20 million.
PAGE_NUMBERS = 16_000_000
# Numbers that the frames of a row are taken to have: two frames of a skin with 45 electrodes.
FRAME_NUMBERS = 4096


class Dataset:
    """A dataset by its name or id. A name stands for the newest dataset that was made with it, when it
    is first read from this object: from then on its id is read, so the rows stay the same.

    The selection is the same in each form: ``columns``, ``slice="0:28"`` (values of each frame),
    ``map="4x20"`` (adds ``force_map_n``: pixel and diameter, mm) and conditions, such as
    ``contact_count__gte=3`` or ``split="train"``.
    """

    def __init__(self, service: Service, name: str) -> None:
        self._service, self._name = service, name

    def __repr__(self) -> str:
        return f"Dataset({self._name!r})"

    @cached_property
    def info(self) -> dict[str, Any]:
        """What the service states about it: definition, rows, columns, counts, what was excluded."""
        found: dict[str, Any] = self._service.get(f"/datasets/{self._name}").json()
        return found

    @property
    def id(self) -> str:
        """Its id, such as ``ds-5a1c0f2e9b3d4c77``: always these rows."""
        return str(self.info["id"])

    def __len__(self) -> int:
        return int(self.info["rows"])

    @property
    def url(self) -> str:
        """The address of its Parquet file, for any other reader."""
        return f"{self._service.url}{PREFIX}/data/{self.id}.parquet"

    def card(self) -> str:
        """Its card in Markdown: what, when, where, units, quality, how to cite it."""
        return self._service.get(f"/datasets/{self.id}/card").body.decode()

    def polars(
        self,
        *,
        columns: Iterable[str] | None = None,
        slice: str | None = None,
        map: str | None = None,
        **conditions: Condition,
    ) -> pl.DataFrame:
        """Its rows for polars. A force map is an array of H x W."""
        return self._read(Polars(), selection(conditions, columns, slice, map))

    def pandas(
        self,
        *,
        columns: Iterable[str] | None = None,
        slice: str | None = None,
        map: str | None = None,
        **conditions: Condition,
    ) -> pd.DataFrame:
        """Its rows for pandas. A frame is an array in its cell, a force map one of H x W."""
        return self._read(Pandas(), selection(conditions, columns, slice, map))

    def arrow(
        self,
        *,
        columns: Iterable[str] | None = None,
        slice: str | None = None,
        map: str | None = None,
        **conditions: Condition,
    ) -> pa.Table:
        """Its rows for Arrow. A force map is a tensor of H x W."""
        return self._read(Arrow(), selection(conditions, columns, slice, map))

    def scan(self) -> pl.LazyFrame:
        """Its rows for lazy polars, which reads the columns and row groups that a question needs.

        With a key or a certificate, which polars cannot send, the file is kept on this machine.
        """
        polars = needed("polars")
        if self._service.reads_by_url_alone:
            lazy: pl.LazyFrame = polars.scan_parquet(self.url)
        else:
            lazy = polars.scan_parquet(self.file())
        return lazy

    def file(self, folder: str | os.PathLike[str] | None = None) -> Path:
        """Its Parquet file on this machine, downloaded once (default: ``~/.cache/palpate``)."""

        def whole(service: Service, part: Any) -> None:
            service.download(f"/data/{self.id}.parquet", None, part)

        return _kept(self._service, _folder(folder) / f"{self.id}.parquet", whole)

    def torch(
        self,
        x: str = "voltages_v",
        y: str = MAP,
        *,
        map: str = "4x20",
        folder: str | os.PathLike[str] | None = None,
        **conditions: Condition,
    ) -> TrialDataset:
        """A ``torch.utils.data.Dataset`` of pairs (x, y): names of columns with numbers.

        A frame has the shape injections x pairs (28 x 28), a force map H x W, and a single value
        none. The rows are kept in a file (default: in ``~/.cache/palpate``) and read from there row
        by row, so that they need not fit into memory. Rows without x or y are excluded.
        """
        from palpate._torch import TrialDataset

        return TrialDataset(self._rows_file((x, y), map, folder, conditions), x, y)

    def _rows_file(
        self,
        columns: Iterable[str],
        map: str,
        folder: str | os.PathLike[str] | None,
        conditions: dict[str, Condition],
    ) -> Path:
        """A file of Arrow streams with these columns, one stream for each page."""
        names = list(columns)
        stored = list(dict.fromkeys(name for name in names if name != MAP)) or ["trial_id"]
        parameters = selection(conditions, stored, None, map if MAP in names else None)
        digest = hashlib.sha256(repr(sorted(parameters.items())).encode()).hexdigest()[:16]

        def pages(_: Service, part: Any) -> None:
            for page in self._pages(parameters):
                part.write(page)

        return _kept(self._service, _folder(folder) / f"{self.id}-{digest}.arrows", pages)

    def _read(self, frames: Frames[F], parameters: Parameters) -> F:
        if not any(value is not None for value in parameters.values()):
            return frames.of_parquet(self._service.get(f"/data/{self.id}.parquet").body)
        map = parameters.get("map")
        return frames.of_streams(list(self._pages(parameters)), map_side(str(map)) if map else None)

    def _pages(self, parameters: Parameters) -> Iterable[bytes]:
        columns, map = parameters.get("columns"), parameters.get("map")
        has_frames = columns is None or names_frames(str(columns))
        limit = page_rows(PAGE_ROWS, has_frames, None if map is None else str(map))
        path = f"/datasets/{self.id}/rows"
        page = self._service.get(path, parameters | {"format": "arrow", "limit": limit})
        yield page.body
        while page.next_path:
            page = self._service.follow(page.next_path)
            yield page.body


def names_frames(columns: str) -> bool:
    """Whether one of these columns, separated by commas, holds frames."""
    return any(name in ("voltages_v", "sim_voltages_v") for name in columns.split(","))


def page_rows(most: int, has_frames: bool, map: str | None = None) -> int:
    """Rows of a page that the service accepts with its frames and maps, at most ``most``.

    >>> page_rows(10_000, False), page_rows(10_000, True), page_rows(10_000, True, "4x20")
    (10000, 3906, 538)
    """
    numbers = (FRAME_NUMBERS if has_frames else 0) + (map_side(map) ** 2 if map else 0)
    return max(1, min(most, PAGE_NUMBERS // max(1, numbers)))


def _folder(folder: str | os.PathLike[str] | None) -> Path:
    if folder is not None:
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "palpate"


def _kept(service: Service, file: Path, write: Any) -> Path:
    """A file that is written once, whole or not at all: what its name stands for never changes."""
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as part:
            try:
                write(service, part)
            except BaseException:
                os.unlink(part.name)
                raise
        os.replace(part.name, file)
    return file

"""Rows of a file of Arrow streams, one at a time, each value with its shape.

Uses: pyarrow (the file is mapped into memory), numpy. Never: the whole file in memory, torch.
"""

from __future__ import annotations

import math
import sys
from bisect import bisect_right
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate._frames import MAP, needed

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Rows:
    """The rows of a file in which each of the named columns has a value.

    A pickled one names its file only: each worker process maps it for itself.
    """

    def __init__(self, file: Path, columns: tuple[str, ...]) -> None:
        self.file, self.columns = file, columns
        self._batches: list[list[NDArray[Any]]] = []
        self._places: list[NDArray[np.int64]] = []
        self._ends: list[int] = []
        self._open()

    def __getstate__(self) -> tuple[Path, tuple[str, ...]]:
        return self.file, self.columns

    def __setstate__(self, state: tuple[Path, tuple[str, ...]]) -> None:
        self.__init__(*state)  # type: ignore[misc]

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, row: int) -> tuple[NDArray[Any], ...]:
        """The values of a row, in the order of the columns."""
        if not -len(self) <= row < len(self):
            raise IndexError(f"row {row}: there are {len(self)}")
        row %= len(self)
        batch = bisect_right(self._ends, row)
        place = self._places[batch][row - (self._ends[batch - 1] if batch else 0)]
        return tuple(values[place] for values in self._batches[batch])

    def _open(self) -> None:
        pyarrow, numpy, ipc = needed("pyarrow"), needed("numpy"), needed("pyarrow.ipc")
        excluded = 0
        source = pyarrow.memory_map(str(self.file))
        while source.tell() < source.size():
            for batch in ipc.open_stream(source):
                arrays = [batch.column(name) for name in self.columns]
                known = numpy.ones(batch.num_rows, dtype=bool)
                for array in arrays:
                    known &= array.is_valid().to_numpy(zero_copy_only=False)
                places = numpy.flatnonzero(known)
                excluded += batch.num_rows - len(places)
                if len(places) == 0:
                    continue
                self._batches.append([
                    values_of(array, name) for array, name in zip(arrays, self.columns, strict=True)
                ])
                self._places.append(places)
                self._ends.append(len(self) + len(places))
        if excluded:
            total = excluded + len(self)
            needs = " or ".join(dict.fromkeys(self.columns))
            print(f"palpate: {excluded} of {total} rows have no {needs}: excluded", file=sys.stderr)


def values_of(array: Any, name: str) -> NDArray[Any]:
    """The values of a column as an array of rows x shape.

    Raises ``TypeError`` if its values are not numbers, or of different lengths.
    """
    pyarrow = needed("pyarrow")
    kind = array.type
    length = kind.list_size if pyarrow.types.is_fixed_size_list(kind) else None
    flat = array if length is None else array.values[array.offset * length : (array.offset + len(array)) * length]
    if not (pyarrow.types.is_integer(flat.type) or pyarrow.types.is_floating(flat.type)):
        raise TypeError(f"{name} is {kind}: x and y must be numbers, or lists of numbers of one length")
    values: NDArray[Any] = flat.to_numpy(zero_copy_only=False)
    return values if length is None else values.reshape(-1, *shape_of(name, length))


def shape_of(name: str, length: int) -> tuple[int, ...]:
    """The shape of a value: frames and maps are squares, if their length is that of one.

    >>> shape_of("voltages_v", 784), shape_of("force_map_n", 25600), shape_of("voltages_v", 208)
    ((28, 28), (160, 160), (208,))
    >>> shape_of("forces_n", 6)
    (6,)
    """
    side = math.isqrt(length)
    square = side * side == length and (name == MAP or name.endswith("voltages_v"))
    return (side, side) if square else (length,)

"""Rows as a dataset of torch.

Uses: torch, ``_rows``. Never: more than one row at a time.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch.utils.data import Dataset

from palpate._rows import Rows


class TrialDataset(Dataset):  # type: ignore[misc]
    """Pairs (x, y) of tensors; a ``DataLoader`` of several workers may read it."""

    def __init__(self, file: Path, x: str, y: str) -> None:
        self.x, self.y = x, y
        self._rows = Rows(file, (x, y))

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, row: int) -> tuple[Any, Any]:
        x, y = self._rows[row]
        # A copy: the file is read-only, and torch writes where it likes.
        return torch.tensor(x), torch.tensor(y)

    def __repr__(self) -> str:
        return f"TrialDataset(x={self.x!r}, y={self.y!r}, rows={len(self)})"

"""Conditions and columns as the service reads them.

Uses: the standard library. Never: a column's name (the service checks them and states its own).
"""

from collections.abc import Iterable
from datetime import date, datetime, timezone

from palpate._http import Parameters

Value = str | int | float | datetime
Condition = Value | Iterable[Value]
"""A value, or several of which one must be met."""


def selection(
    conditions: dict[str, Condition],
    columns: Iterable[str] | None = None,
    slice: str | None = None,
    map: str | None = None,
) -> Parameters:
    """The parameters of a selection.

    >>> selection({"max_force_n__gt": 10, "tips": [1, 4]}, columns=["trial_id", "fvu"])
    {'max_force_n__gt': '10', 'tips__in': '1,4', 'columns': 'trial_id,fvu', 'slice': None, 'map': None}
    """
    parameters: Parameters = {}
    for name, value in conditions.items():
        if isinstance(value, str) or not isinstance(value, Iterable):
            parameters[name] = _word(value)
        else:
            several = ",".join(map_words(value))
            parameters[name if name.endswith("__in") else f"{name}__in"] = several
    if isinstance(columns, str):
        columns = columns.split(",")
    joined = None if columns is None else ",".join(name.strip() for name in columns)
    return parameters | {"columns": joined, "slice": slice, "map": map}


def map_words(values: Iterable[Value]) -> list[str]:
    """Each value as the service reads it."""
    return [_word(value) for value in values]


def _word(value: Value) -> str:
    """A value as the service reads it; a time without a zone is local.

    >>> _word(datetime(2026, 3, 1, 12, tzinfo=timezone.utc))
    '2026-03-01T12:00:00+00:00'
    """
    if isinstance(value, datetime):
        return value.astimezone(timezone.utc).isoformat()
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day).astimezone(timezone.utc).isoformat()
    return str(value)


def map_side(map: str) -> int:
    """Pixels along a side of a force map, which covers 640 x 640 mm if no side is stated.

    >>> map_side("4x20"), map_side("2.5x10x100")
    (160, 40)
    """
    pixel_mm, *_, side_mm = [*map.split("x"), "640"][:3]
    return round(float(side_mm) / float(pixel_mm))

"""Reads the trials and datasets of a Palpate service as polars, pandas, Arrow or torch.

    >>> from palpate import Palpate
    >>> lab = Palpate()                                      # doctest: +SKIP
    >>> lab.sql("SELECT contact_count, count(*) AS n FROM trials GROUP BY contact_count")  # doctest: +SKIP
"""

from palpate._client import Palpate
from palpate._dataset import Dataset
from palpate._error import PalpateError

__all__ = ["Dataset", "Palpate", "PalpateError"]
__version__ = "0.1.0"

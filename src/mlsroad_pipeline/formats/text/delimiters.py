"""Delimiter, decimal mark and numeric columns of a text file, from its first rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mlsroad_pipeline.formats.text.values import WHITESPACE, is_number, split_row


def sniffed(sample: Sequence[str], delimiter: str | None, decimal: str | None) -> tuple[str, str]:
    """Return the delimiter and the decimal mark for which most values are numbers, equally many in each row.

    Those that are given are kept; the first row of the sample may hold names.
    """
    row = sample[-1 if len(sample) < 3 else 1]
    blanks = WHITESPACE if "  " in row or row != row.strip() else " "
    delimiters = [delimiter] if delimiter else [*(d for d in (";", ",", "\t") if d in row), blanks]
    marks = [decimal] if decimal else [".", ","]
    candidates = [(d, m) for d in delimiters for m in marks if d != m]
    for rows in (sample, sample[1:]):  # the first row may be names
        shares = [numeric_share(rows, *candidate) for candidate in candidates]
        if rows and (max(shares) == 1.0 or (rows is not sample and max(shares) > 0)):
            return candidates[int(np.argmax(shares))]  # of several the first: sorted by reliability
    return candidates[0]


def numeric_share(rows: Sequence[str], delimiter: str, decimal: str) -> float:
    """Return the share of numbers among the values of rows.

    It is 0 where rows differ in length or have fewer than three columns of numbers.
    """
    values = [split_row(line, delimiter) for line in rows]
    width = len(values[0]) if values else 0
    if width < 3 or any(len(found) != width for found in values):
        return 0.0
    good = np.array([[is_number(value, decimal) for value in found] for found in values]).mean(axis=0)
    return float(good.mean()) if (good >= 0.5).sum() >= 3 else 0.0


def numeric_columns(body: Sequence[str], delimiter: str, decimal: str, width: int) -> tuple[int, ...] | None:
    """Return the indices of columns with a number in some row of the sample; None if all have."""
    rows = [found for found in (split_row(line, delimiter) for line in body) if len(found) == width]
    kept = tuple(i for i in range(width) if any(is_number(found[i], decimal) for found in rows) or not rows)
    return None if len(kept) == width else kept

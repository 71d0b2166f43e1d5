"""Classification Lookup record: names of the class codes of a file (LAS 1.4 R15, section 2.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mlsroad_pipeline.formats.las.header import LasHeader, Vlr

LOOKUP = (b"LASF_Spec", 0)
ENTRY = np.dtype([("code", "u1"), ("name", "S15")])
N_CODES = 256


def class_names(header: LasHeader) -> dict[int, str]:
    """Return code to name of the classes that a file names; empty without the record."""
    return {code: name.decode("utf-8", "replace") for code, name in _stored_names(header).items()}


def _stored_names(header: LasHeader) -> dict[int, bytes]:
    record = header.find(LOOKUP)
    if record is None:
        return {}
    entries = np.frombuffer(record.data[: len(record.data) // ENTRY.itemsize * ENTRY.itemsize], dtype=ENTRY)
    return {int(code): name for code, name in entries.tolist() if name}


def with_class_names(header: LasHeader, names: Mapping[int, str]) -> LasHeader:
    """Add names of class codes, 15 ASCII characters of each, to a header; those of other codes are kept."""
    if not names:
        return header
    entries = np.zeros(N_CODES, dtype=ENTRY)
    entries["code"] = np.arange(N_CODES)
    own = {code: name.encode("ascii", "replace") for code, name in names.items()}
    for code, text in {**_stored_names(header), **own}.items():
        entries["name"][code] = text
    record = Vlr(*LOOKUP, entries.tobytes(), b"Classification Lookup")
    others = header.without(LOOKUP)
    return replace(others, vlrs=(*others.vlrs, record))

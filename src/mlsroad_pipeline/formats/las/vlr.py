"""Variable length records of LAS files (ASPRS LAS specification 1.4 R15, sections 2.5 and 2.7)."""

from __future__ import annotations

import struct
from dataclasses import dataclass


@dataclass(frozen=True)
class Vlr:
    """A variable length record, or an extended one (EVLR).

    Parameters
    ----------
    user_id : bytes
        Whose record it is, up to 16 bytes; one that was read keeps its padding.
    record_id : int
        Which of this user's records it is, 0 to 65535.
    data : bytes
        What it holds, without its head.
    description : bytes, default empty
        Free text, up to 32 bytes.
    reserved : int, default 0
        The head's first two bytes, as they were read.
    """

    user_id: bytes
    record_id: int
    data: bytes
    description: bytes = b""
    reserved: int = 0

    @property
    def key(self) -> tuple[bytes, int]:
        """Return user id (without padding) and record id, which together say what the record is."""
        return self.user_id.split(b"\0")[0], self.record_id

    def pack(self, *, extended: bool = False) -> bytes:
        """Return the record as it stands in a file.

        Parameters
        ----------
        extended : bool, default False
            Whether its length is stored in 64 bits.

        Returns
        -------
        bytes
            Head and data.
        """
        form = "<H16sHQ32s" if extended else "<H16sHH32s"
        head = struct.pack(form, self.reserved, self.user_id, self.record_id, len(self.data), self.description)
        return head + self.data

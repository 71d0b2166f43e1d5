"""Variable length records of LAS files (ASPRS LAS specification 1.4 R15, sections 2.5 and 2.7)."""

from __future__ import annotations

import struct
from dataclasses import dataclass


@dataclass(frozen=True)
class Vlr:
    """A variable length record, or an extended one (EVLR)."""

    user_id: bytes  # identifier of the record's owner, up to 16 bytes; a record read from a file keeps its padding
    record_id: int  # number of the record among those of the user, 0 to 65535
    data: bytes  # payload, without the record header
    description: bytes = b""  # free text, up to 32 bytes
    reserved: int = 0  # first two bytes of the record header, as read

    @property
    def key(self) -> tuple[bytes, int]:
        """Return user id (without padding) and record id, which together identify the type of the record."""
        return self.user_id.split(b"\0")[0], self.record_id

    def pack(self, *, extended: bool = False) -> bytes:
        """Return the bytes of the record in a file."""
        form = "<H16sHQ32s" if extended else "<H16sHH32s"
        head = struct.pack(form, self.reserved, self.user_id, self.record_id, len(self.data), self.description)
        return head + self.data

"""The FMI call under way, noted where another process can read it after this one has crashed."""

from __future__ import annotations

import sys
from typing import Any

__all__ = ["CALLS", "NOTE_SIZE", "Calls", "noted_call"]

NOTE_SIZE = 2**16
"""Bytes of a note: enough for the calls of hundreds of components."""

_HEAD = 8


class Calls:
    """Notes the FMI calls of this process in a buffer.

    The buffer begins with a number of 8 bytes: where in it the text of the latest call begins, or
    0. The texts stand behind it, each ended by a zero. So one call costs one assignment.

    Attributes
    ----------
    note : memoryview
        ``note[0] = calls.code(..)`` notes a call.
    """

    def __init__(self) -> None:
        self.use(bytearray(NOTE_SIZE))

    def use(self, buffer: Any) -> None:
        """Note calls in this buffer of `NOTE_SIZE` bytes; for slaves that are made from now on."""
        self._texts = memoryview(buffer).cast("B")
        self.note = self._texts[:_HEAD].cast("Q")
        self._codes: dict[str, int] = {}
        self._end = _HEAD

    def code(self, text: str) -> int:
        """What stands for a call in the note; 0 where the buffer is full."""
        if text not in self._codes:
            content = text.encode() + b"\0"
            end = self._end + len(content)
            if end > len(self._texts):
                return 0
            self._texts[self._end : end] = content
            self._codes[text], self._end = self._end, end
        return self._codes[text]

    def clear(self) -> None:
        """Note that no call is under way."""
        self.note[0] = 0


CALLS = Calls()
"""Those of this process."""


def noted_call(buffer: Any) -> str:
    """The text of the latest call noted in a buffer; empty where there is none."""
    content = bytes(memoryview(buffer).cast("B"))
    place = int.from_bytes(content[:_HEAD], sys.byteorder)
    return content[place : content.index(b"\0", place)].decode() if place else ""

"""The files of a folder that any process opens, by Linux' inotify."""

import ctypes
import os
import struct
from pathlib import Path

_OPENED = 0x20
_EVENT = struct.Struct("iIII")


class OpenedFiles:
    """A watch on a folder; `names()` gives and forgets the names that were opened in it."""

    def __init__(self, folder: Path) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        self._handle = library.inotify_init1(os.O_NONBLOCK)
        if (
            self._handle < 0
            or library.inotify_add_watch(self._handle, os.fsencode(folder), _OPENED) < 0
        ):
            raise OSError(ctypes.get_errno(), "inotify")

    def names(self) -> set[str]:
        found = set()
        while True:
            try:
                data = os.read(self._handle, 2**16)
            except BlockingIOError:
                return found
            at = 0
            while at < len(data):
                length = _EVENT.unpack_from(data, at)[3]
                name = data[at + _EVENT.size : at + _EVENT.size + length]
                found.add(os.fsdecode(name.rstrip(b"\0")))
                at += _EVENT.size + length

    def close(self) -> None:
        os.close(self._handle)

"""A CSV file that grows by rows during a run, and that a resumed run continues."""

import os
from collections.abc import Sequence
from io import FileIO
from pathlib import Path
from typing import Any

from granflow.io.atomic_files import named_errors, separate_from_links
from granflow.io.lock import LostFiles, identity_of
from granflow.io.tables import csv_line


class RowFile:
    """Rows of a CSV file, flushed one by one.

    `path`: of the file; it replaces an existing one at the first row, unless a state was restored.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: FileIO | None = None
        self._size, self._unwritten = 0, b""
        self._last = b""

    @property
    def is_empty(self) -> bool:
        """Whether there are no rows yet, not even a header."""
        return not self._size and not self._unwritten

    def write(self, row: Sequence[Any], replaces_last: bool = False) -> None:
        """Write one row and flush it; bytes that could not be written are kept for the next call.

        `replaces_last`: in place of the last row, if that is completely written. Raises LostFiles if another program
        has moved, deleted, replaced or changed the file, OSError if it cannot be written.
        """
        line = csv_line(row).encode()
        self._open()
        self.check()
        if replaces_last and not self._unwritten:
            self._cut(self._size - len(self._last))
        self._unwritten += line
        self._last = line
        self._write_rest()

    def _open(self) -> FileIO:
        if self._file is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            separate_from_links(self.path)
            self._file = FileIO(self.path, "a" if self._size else "w")
        return self._file

    def _cut(self, size: int) -> None:
        """Remove the bytes after `size` from the open file."""
        file = self._open()
        with named_errors(self.path):
            file.truncate(size)
            file.seek(size)
        self._size = size

    def _write_rest(self) -> None:
        """Write the bytes that are not written yet."""
        file = self._open()
        with named_errors(self.path):
            while self._unwritten:
                written = file.write(self._unwritten)
                self._size, self._unwritten = self._size + written, self._unwritten[written:]

    def check(self) -> None:
        """Raise LostFiles if the path leads to another file than the open one, or if that has another size."""
        if self._file is None:
            return
        try:
            found = os.stat(self.path)
        except OSError:
            raise LostFiles(self.path, "it was moved or deleted during the run") from None
        own = os.fstat(self._file.fileno())
        if identity_of(found) != identity_of(own):
            raise LostFiles(self.path, "another file has replaced it during the run")
        if own.st_size != self._size:
            raise LostFiles(
                self.path, f"another program has changed it: it has {own.st_size} bytes, and the run wrote {self._size}"
            )

    def close(self) -> None:
        """Close the file; a further row opens it again."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def sync(self) -> None:
        """Flush all rows to the disk. Raises OSError."""
        if self._file is not None:
            os.fsync(self._file.fileno())

    def state_dict(self) -> dict[str, Any]:
        """Return the file size [bytes] without the last row, which a later one may replace, and this row.

        If bytes could not be written: the size, and these bytes.
        """
        last = b"" if self._unwritten else self._last
        return {"size": self._size - len(last), "unwritten": (last or self._unwritten).decode()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`; the file is not modified yet."""
        self._size, self._unwritten = saved["size"], saved["unwritten"].encode()
        self._last = self._unwritten

    @property
    def is_intact(self) -> bool:
        """Whether the file still contains all rows of the restored state."""
        return self._present_size() >= self._size

    def truncate(self) -> None:
        """Remove the rows after the restored state; if earlier rows are missing, continue with the remaining ones.

        Raises OSError if the last row of the restored state cannot be written.
        """
        if self._size:
            self._size = min(self._size, self._present_size())
            if self._size:
                separate_from_links(self.path)
                os.truncate(self.path, self._size)
                self._write_rest()
                self.close()
            else:
                self._unwritten = self._last = b""  # the next row follows a new header

    def _present_size(self) -> int:
        """Size of the file [bytes]."""
        return self.path.stat().st_size if self.path.is_file() else 0

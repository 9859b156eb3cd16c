"""stdout and stderr whose reader may close the pipe: `granflow explain SCENE | head`."""

import errno
import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

EXIT_PIPE = 141
"""128 + SIGPIPE: the code that shells report for a command whose reader closed the pipe."""


class Output:
    """Reaction to a failed write to a standard stream.

    If `needed`, the command ends: silently with EXIT_PIPE when the reader closed the pipe, otherwise with the OSError.
    If not, the command continues and its output is dropped: lost progress lines must not end a simulation.
    """

    needed = True

    def failed(self, error: OSError, name: str) -> None:
        """Handle the first failed write to the stream `name`.

        If `needed`, raises SystemExit(EXIT_PIPE) for a closed pipe, and OSError with the name of the stream otherwise.
        """
        if not self.needed:
            return
        if error.errno == errno.EPIPE:
            raise SystemExit(EXIT_PIPE)
        error.filename = name
        raise error


class _Stream(io.FileIO):
    """A standard stream that drops all output after a failed write.

    It writes to the file descriptor of `stream` and does not close it.
    """

    def __init__(self, stream: TextIO, output: Output) -> None:
        super().__init__(stream.fileno(), "w", closefd=False)
        self._shown_name, self._output, self._lost = stream.name, output, False

    def write(self, data: Any, /) -> int:
        """Write `data` to the stream, or drop it after a failed write; return the number of bytes.

        Raises the exceptions of `Output.failed` at the first failure.
        """
        if not self._lost:
            try:
                return super().write(data)
            except OSError as error:
                self._lost = True
                self._output.failed(error, self._shown_name)
        return memoryview(data).nbytes


@contextmanager
def standard_streams() -> Iterator[Output]:
    """Handle failed writes to stdout and stderr by `Output.failed`; the block may set `needed`.

    Both streams are replaced in the block and restored at the end. Streams of notebooks, tests and the Windows console
    are not replaced.
    """
    output = Output()
    names = [name for name in ("stdout", "stderr") if _is_process_stream(name)]
    before = {name: getattr(sys, name) for name in names}
    for name, stream in before.items():
        _replace(name, _wrapped(stream, output))
    try:
        yield output
        _flush(names)
    except SystemExit:
        _flush(names)
        raise
    finally:
        output.needed = False
        _flush(names)
        for name, stream in before.items():
            _replace(name, stream)


def _is_process_stream(name: str) -> bool:
    """Return whether a stream is that of the process: not of a notebook or test, nor the console of Windows."""
    stream = getattr(sys, name)
    console = sys.platform == "win32" and stream is not None and stream.isatty()
    return stream is not None and stream is getattr(sys, f"__{name}__") and not console


def _wrapped(stream: TextIO, output: Output) -> io.TextIOWrapper:
    """Return a text stream with the encoding and buffering of `stream`, on top of a `_Stream`."""
    stream.flush()
    buffer = io.BufferedWriter(_Stream(stream, output))
    return io.TextIOWrapper(
        buffer, stream.encoding, stream.errors, line_buffering=getattr(stream, "line_buffering", False),
        write_through=getattr(stream, "write_through", False),
    )  # fmt: skip


def _replace(name: str, stream: TextIO) -> None:
    """Set both names of a stream: if they differ, Taichi assumes a notebook."""
    setattr(sys, name, stream)
    setattr(sys, f"__{name}__", stream)


def _flush(names: list[str]) -> None:
    """Flush the streams with these names."""
    for name in names:
        getattr(sys, name).flush()

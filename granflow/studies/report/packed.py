"""Compressed data in a page: base64 text of deflated bytes, which the script of the page inflates."""

from base64 import b64encode
from typing import Any
from zlib import compress

import numpy as np

ALIGNMENT = 4
"""Arrays begin at multiples of this number of bytes, as typed arrays of JavaScript require."""


def deflated(data: bytes) -> str:
    """Base64 text of the data in zlib format, `deflate` of DecompressionStream in a browser."""
    return b64encode(compress(data, 9)).decode("ascii")


class PackedArrays:
    """Arrays one after the other, each content once."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._references: dict[tuple[str, bytes], dict[str, Any]] = {}
        self._size = 0

    def add(self, array: np.ndarray) -> dict[str, Any]:
        """Append an array of unsigned integers; return its type in JavaScript, offset in bytes and length."""
        content = (array.dtype.name, np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
        if content not in self._references:
            self._references[content] = {
                "type": f"{array.dtype.name.capitalize()}Array",
                "offset": self._size,
                "length": array.size,
            }
            padded = content[1] + b"\0" * (-len(content[1]) % ALIGNMENT)
            self._parts.append(padded)
            self._size += len(padded)
        return self._references[content]

    def text(self) -> str:
        """All arrays as compressed text."""
        return deflated(b"".join(self._parts))

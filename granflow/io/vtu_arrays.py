"""Arrays of VTU files: ASCII, base64 or appended data, zlib or LZMA compression. No length in the file is trusted.

Each array is decoded up to the length that follows from the numbers of points and cells, and all arrays of a file share
a limit: meshio decompresses without limits.
"""

import base64
import lzma
import warnings
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from granflow.io.regular_files import FormatError

DTYPES = {
    **{f"Float{8 * size}": f"f{size}" for size in (4, 8)},
    **{f"Int{8 * size}": f"i{size}" for size in (1, 2, 4, 8)},
    **{f"UInt{8 * size}": f"u{size}" for size in (1, 2, 4, 8)},
}
"""numpy type by VTK type, without the byte order."""

MAX_COMPONENTS, MAX_ARRAYS = 64, 1000
"""Largest number of components of an array, and of arrays of a file."""

DECOMPRESSORS: dict[str | None, Callable[[memoryview, int], bytes] | None] = {
    None: None,
    "vtkZLibDataCompressor": lambda block, most: zlib.decompressobj().decompress(block, most),
    "vtkLZMADataCompressor": lambda block, most: lzma.LZMADecompressor(memlimit=2**28).decompress(block, most),
}
"""Function (block, largest length) -> bytes by compressor of VTK."""


@dataclass
class ArraySource:
    """Encoding of the arrays of a file, the appended data, and the number of bytes that may still be decoded.

    order:       byte order, "<" or ">"
    header:      integer type of the lengths before each array
    decompress:  entry of DECOMPRESSORS
    bytes_left:  number of bytes that may still be decoded
    appended:    appended data, raw or base64
    raw:         True if the appended data are raw
    count:       number of arrays read so far
    """

    order: str
    header: np.dtype
    decompress: Callable[[memoryview, int], bytes] | None
    bytes_left: int
    appended: memoryview
    raw: bool
    count: int = 0

    @classmethod
    def of(cls, root: ElementTree.Element, raw: bytes, largest: int) -> "ArraySource":
        """Encoding by the attributes of the root; `raw`: appended data. Raises KeyError for an unknown one."""
        order = {"LittleEndian": "<", "BigEndian": ">"}[root.attrib.get("byte_order", "LittleEndian")]
        header = np.dtype(order + {"UInt32": "u4", "UInt64": "u8"}[root.attrib.get("header_type", "UInt32")])
        element = root.find("AppendedData")
        is_raw = element is not None and element.attrib.get("encoding") == "raw"
        text = "" if element is None else (element.text or "").strip().removeprefix("_")
        appended = memoryview(raw if is_raw else text.encode())
        return cls(order, header, DECOMPRESSORS[root.attrib.get("compressor")], largest, appended, is_raw)

    def array(self, element: ElementTree.Element, count: int, components: int) -> np.ndarray:
        """Array (count, components) in native byte order.

        Raises FormatError if the length differs, or if the limits on arrays, components or bytes are exceeded.
        """
        dtype = np.dtype(self.order + DTYPES[element.attrib["type"]])
        size = count * components * dtype.itemsize
        self.count += 1
        self.bytes_left -= size
        if self.count > MAX_ARRAYS or not 1 <= components <= MAX_COMPONENTS:
            raise FormatError("has too many arrays, or an array with too many components")
        if self.bytes_left < 0:
            raise FormatError(f"declares arrays larger than the limit of {(self.bytes_left + size) / 2**20:.0f} MiB")
        form = element.attrib.get("format", "ascii")
        if form == "ascii":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # numpy stops at the first invalid number; the length is then wrong
                found = np.fromstring(element.text or "", dtype, sep=" ").tobytes()
        elif form == "appended":
            found = self._bytes(self.appended[int(element.attrib["offset"]) :], self.raw, size)
        else:
            found = self._bytes(memoryview("".join((element.text or "").split()).encode()), False, size)
        if len(found) != size:
            more = "more" if len(found) > size else "fewer"
            raise FormatError(
                f"has an array of {more} than the {size} bytes that follow from its numbers of points and cells"
            )
        return np.frombuffer(found, dtype).reshape(count, components).astype(dtype.newbyteorder("="))

    def _bytes(self, data: memoryview, raw: bool, size: int) -> bytes:
        """At most `size` + 1 bytes of an array, after their lengths; `raw`: not base64."""
        width = self.header.itemsize
        number, rest = _split(data, raw, width)
        first = int(self._lengths(number, 1)[0])
        if self.decompress is None:
            if first != size:
                raise FormatError(
                    f"has an array of {first} bytes, but {size} follow from its numbers of points and cells"
                )
            separate = raw or (bytes(data[: _encoded(width)]).endswith(b"=") and len(rest))
            return _split(rest, raw, size)[0] if separate else _split(data, raw, width + size)[0][width:]
        if first > len(data):
            raise FormatError("declares more compressed blocks than it contains bytes")
        numbers, rest = _split(data, raw, width * (3 + first))
        lengths = self._lengths(numbers, 3 + first)[3:].astype(np.int64)
        body = rest if raw else memoryview(_split(rest, raw, int(lengths.sum()))[0])
        return b"".join(self._decompressed(body, lengths.tolist(), size))

    def _lengths(self, found: bytes, count: int) -> np.ndarray:
        """The `count` integers before an array. Raises FormatError if truncated."""
        if len(found) != count * self.header.itemsize:
            raise FormatError("is truncated in the header of an array")
        return np.frombuffer(found, self.header)

    def _decompressed(self, body: memoryview, lengths: list[int], size: int) -> Iterator[bytes]:
        """Decompressed blocks, at most `size` + 1 bytes in total; `lengths`: compressed length of each block."""
        left, begin = size + 1, 0
        assert self.decompress is not None
        for length in lengths:
            if length < 0 or begin + length > len(body):
                raise FormatError("is truncated in a compressed block")
            try:
                piece = self.decompress(body[begin : begin + length], left) if left else b""
            except (zlib.error, lzma.LZMAError) as error:
                raise FormatError(f"has a damaged compressed block: {error}") from None
            left, begin = left - len(piece), begin + length
            yield piece


def _split(data: memoryview, raw: bool, size: int) -> tuple[bytes, memoryview]:
    """The first `size` bytes, fewer if truncated, and the data after them; base64 data have groups of four."""
    if raw:
        return bytes(data[:size]), data[size:]
    text = data[: _encoded(size)]
    return base64.b64decode(text[: len(text) // 4 * 4])[:size], data[len(text) :]


def _encoded(size: int) -> int:
    """Number of base64 characters that encode `size` bytes."""
    return 4 * -(-size // 3)

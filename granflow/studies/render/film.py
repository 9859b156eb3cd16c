"""Films from pictures: MP4 by the ffmpeg of the package imageio-ffmpeg."""

from collections.abc import Iterable
from contextlib import closing
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import numpy as np

from granflow.io.atomic_files import replacing

CONSTANT_RATE_FACTOR = 25
"""Quality of H.264, 0 (lossless) to 51: without visible block artifacts around particles."""

OUTPUT = ("-crf", str(CONSTANT_RATE_FACTOR), "-f", "mp4", "-movflags", "+faststart")
"""Quality; explicit format, because the temporary name has another suffix; the index first, for streaming."""


def missing_for_film() -> str | None:
    """Name of the package that films require if it is not installed, else None."""
    return "imageio-ffmpeg" if find_spec("imageio_ffmpeg") is None else None


def write_film(path: Path, pictures: Iterable[np.ndarray], rate: float) -> None:
    """Write one or more pictures (height, width, 3), 0 to 255, of one even size as MP4 with `rate` pictures per second.

    The file is replaced when it is complete. Raises ImportError without imageio-ffmpeg; see `missing_for_film`.
    """
    from imageio_ffmpeg import write_frames

    with replacing(path) as temporary:
        remaining = iter(pictures)
        first = next(remaining)
        writer = write_frames(
            str(temporary), first.shape[1::-1], fps=rate, quality=None, macro_block_size=2,
            output_params=list(OUTPUT), ffmpeg_log_level="error",
        )  # fmt: skip
        with closing(writer):
            writer.send(None)
            for picture in chain([first], remaining):
                writer.send(np.ascontiguousarray(picture))

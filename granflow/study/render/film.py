"""A film from pictures: MP4 through the ffmpeg that the package imageio-ffmpeg brings."""

from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from granflow.observe import replacing

QUALITY = 8
"""Of imageio's 0 to 10: no blocks to be seen around grains."""

PLAYS_AT_ONCE = ("-f", "mp4", "-movflags", "+faststart")
"""The format, as the temporary name does not say it; and the index first, so that browsers begin without the whole."""


def missing_for_film() -> str | None:
    """The package that films need, where it is not installed."""
    return "imageio-ffmpeg" if find_spec("imageio_ffmpeg") is None else None


def write_film(path: Path, pictures: Iterable[np.ndarray], rate: float) -> None:
    """Write pictures (height, width, 3) of one even size, 0 to 255, as MP4 of `rate` a second, whole or not at all."""
    from imageio_ffmpeg import write_frames

    with replacing(path) as temporary:
        writer = None
        try:
            for picture in pictures:
                if writer is None:
                    writer = write_frames(
                        str(temporary), picture.shape[1::-1], fps=rate, quality=QUALITY,
                        macro_block_size=2, output_params=list(PLAYS_AT_ONCE), ffmpeg_log_level="error",
                    )  # fmt: skip
                    writer.send(None)
                writer.send(np.ascontiguousarray(picture))
        finally:
            if writer is not None:
                writer.close()

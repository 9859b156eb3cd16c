"""`granflow render`: pictures and films from the frames of a run."""

from granflow.study.render.film import write_film
from granflow.study.render.frames import Frame, chosen, frames_of
from granflow.study.render.render import Look, pictures, write_pictures

__all__ = ["Frame", "Look", "chosen", "frames_of", "pictures", "write_film", "write_pictures"]

"""`granflow render`: pictures and films from the frames of a run."""

from granflow.studies.render.film import write_film
from granflow.studies.render.frames import Frame, frames_of, selected_frames
from granflow.studies.render.render import PictureStyle, pictures, write_pictures

__all__ = ["Frame", "PictureStyle", "selected_frames", "frames_of", "pictures", "write_film", "write_pictures"]

"""Files: formats, atomic writing, lock, log and checkpoint archives. Knows arrays and text, not scenes."""

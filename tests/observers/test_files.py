"""Files are written completely or not at all."""

import pytest

from granflow.io.files import replacing, write_text


def test_failed_write_keeps_the_old_file_and_no_temporary_file(tmp_path):
    path = tmp_path / "frame.vtu"
    path.write_text("old")
    with pytest.raises(OSError, match="disk full"), replacing(path) as temporary:
        temporary.write_text("half")
        raise OSError("disk full")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_temporary_file_is_hidden_and_in_the_directory_of_the_target(tmp_path):
    path = tmp_path / "frame.vtu"
    write_text(path, "old")
    with replacing(path) as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path and temporary.name.startswith(".")
        assert path.read_text() == "old"
    assert path.read_text() == "new"

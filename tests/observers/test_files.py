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
    with replacing(tmp_path / "frame.vtu") as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path
        assert temporary.name.startswith(".")
        assert not (tmp_path / "frame.vtu").exists()
    assert (tmp_path / "frame.vtu").read_text() == "new"


def test_written_text_replaces_the_file(tmp_path):
    for text in ("first", "second"):
        write_text(tmp_path / "a.txt", text)
    assert (tmp_path / "a.txt").read_text() == "second"

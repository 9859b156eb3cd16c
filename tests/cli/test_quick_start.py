"""The start of a command does not collect garbage, and ends with the collection as it was before."""

import gc
import time

import pytest

from granflow.cli import process as module
from granflow.cli.process import quick_start


@pytest.fixture(autouse=True)
def collection_enabled(monkeypatch):
    """Garbage collection at the beginning of the test and after it; a short pause."""
    monkeypatch.setattr(module, "PAUSE", 0.01)
    gc.enable()
    yield
    gc.enable()


def is_enabled_within(seconds: float) -> bool:
    """Whether garbage collection is enabled within a time."""
    end = time.monotonic() + seconds
    while not gc.isenabled() and time.monotonic() < end:
        time.sleep(0.005)
    return gc.isenabled()


def test_garbage_collection_pauses_in_the_block_and_shortly_after():
    with quick_start():
        assert not gc.isenabled()
    assert is_enabled_within(30.0)


def test_garbage_collection_resumes_after_an_error():
    with pytest.raises(KeyError), quick_start():
        raise KeyError
    assert is_enabled_within(30.0)


def test_disabled_garbage_collection_remains_disabled():
    gc.disable()
    with quick_start():
        pass
    assert not is_enabled_within(0.1)

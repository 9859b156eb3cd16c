"""The start of a command does not collect garbage, and ends with the collection as it was before."""

import gc

import pytest

from granflow.cli.process import quick_start


@pytest.mark.parametrize("enabled", [True, False])
def test_garbage_collection_pauses_in_the_block(enabled):
    try:
        (gc.enable if enabled else gc.disable)()
        with pytest.raises(KeyError), quick_start():
            assert not gc.isenabled()
            raise KeyError
        assert gc.isenabled() == enabled
    finally:
        gc.enable()

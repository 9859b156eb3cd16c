"""Many runs in worker processes, each in a directory of its own, on this machine or through Dask."""

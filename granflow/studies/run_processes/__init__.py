"""Many runs: each one a process of its own, in a directory of its own, on this machine or through Dask."""

"""One scene on several MPI ranks, with the same bits on any number of ranks."""

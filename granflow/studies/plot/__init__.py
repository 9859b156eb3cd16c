"""`granflow plot`: columns of time series against time or against each other."""

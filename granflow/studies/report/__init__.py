"""`granflow report`: an HTML page that summarizes a run."""

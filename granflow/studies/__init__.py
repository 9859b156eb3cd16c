"""Studies of accuracy, stability and cost, comparisons, fits, pictures and HTML reports."""

"""Invalid inputs and faults: the table of the documentation and the cases behind it."""

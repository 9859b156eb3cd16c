"""What stands behind tools/bench.py: cases, codes, rounds, tables, the page, and where the time goes."""

"""Modules of tools/bench.py: cases, codes, rounds, tables, page, and the time of each phase."""

"""Comparison of granflow with published numbers and closed forms; each case has an allowed deviation and a
status."""

"""Generates the reference pages, tables and pictures of the documentation site from the code of granflow."""

"""Block `walls`: one file per family of walls, with the keys of its kinds and their surface.

`wall` has the keys that all kinds share, `kinds` lists the kinds.
"""

"""`granflow compare`: one scene with several normal contact models, side by side."""

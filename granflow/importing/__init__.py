"""Translation of input scripts of LIGGGHTS and LAMMPS to scenes.

`language` reads the language of the scripts into commands, `deck` holds what the commands have said, one file
per family of commands has the table of its translations, `scene_text` writes the scene, `report` says what
became of each line, and `convert` runs all of them.
"""

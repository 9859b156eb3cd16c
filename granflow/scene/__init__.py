"""Scene files: reading, validation and messages.

`blocks` is the schema, one module per block of a scene file; `blocks.scene.SceneInput` is a whole scene as
written. `document` reads YAML with positions, `reader` makes a `SceneInput` of it, `checks` finds
contradictions between the blocks, `messages` and `suggest` say what is wrong, `reference` explains the keys.
"""

"""Scene files: the blocks, their reading and checks.

`blocks` has one module per block of a scene file; `blocks.scene.SceneInput` is a whole scene as written.
`reader` makes a `SceneInput` of a file, `checks` finds contradictions between the blocks, `reference`
explains the keys. The language that the blocks are written in is `granflow.schema`.
"""

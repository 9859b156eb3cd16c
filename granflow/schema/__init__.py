"""The language in which keys are declared: those of scenes, contact models, sweeps and calibrations.

`document` reads YAML with positions, `model` has the base class and the building blocks of all keys,
`quantities` numbers with units, `faults` and `messages` say what is wrong.
"""

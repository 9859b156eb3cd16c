"""Cost of features: step time of a scene, and of its variants with one feature switched on or off."""

"""Reference of the keys of a scene, from the schema that reads scenes: for the site and for the terminal."""

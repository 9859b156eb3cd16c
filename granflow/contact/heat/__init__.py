"""Heat models, and the temperature of the particles."""

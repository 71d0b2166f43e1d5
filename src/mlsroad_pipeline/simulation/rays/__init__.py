"""Ray casting against static and moving objects."""

"""The wiring edge: one folder per pipeline, thin."""

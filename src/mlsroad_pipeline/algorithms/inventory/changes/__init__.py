"""Changes between two surveys: objects, and surfaces."""

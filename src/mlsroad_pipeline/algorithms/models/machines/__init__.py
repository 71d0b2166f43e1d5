"""Learning machines: trees, forests, kernel machines, training of networks."""

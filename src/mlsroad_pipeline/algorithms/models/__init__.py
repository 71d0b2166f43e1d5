"""Learned models: forests, kernel machines, training of networks, model bundles."""

"""Parameters of streets and scanners, with presets."""

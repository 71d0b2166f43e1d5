"""Ground classification and ground surface."""

"""Points labelled through images: cameras, projection, visibility."""

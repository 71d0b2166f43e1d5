"""Quality of a survey: duplicates, statistics per chunk, inspection and report tables."""

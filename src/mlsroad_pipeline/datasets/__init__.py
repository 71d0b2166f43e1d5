"""The I/O edge: one Kedro dataset class per file, and the readers and writers that they stand on."""

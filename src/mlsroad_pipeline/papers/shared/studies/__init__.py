"""Parameters, streets, tables and figures of all studies."""

"""The experiments of the papers, as plain functions: what is run, and what the tables are made of."""

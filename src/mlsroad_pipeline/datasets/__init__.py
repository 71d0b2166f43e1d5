"""Kedro datasets; `inventory`, `models` and `reports` include the file formats behind theirs."""

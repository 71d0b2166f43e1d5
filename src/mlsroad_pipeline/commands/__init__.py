"""Programs beside `kedro run`."""

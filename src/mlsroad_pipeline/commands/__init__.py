"""Commands besides `kedro run`."""

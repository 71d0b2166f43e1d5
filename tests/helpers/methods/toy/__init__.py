"""A method as `docs/how_to/add_a_method.md` adds one."""

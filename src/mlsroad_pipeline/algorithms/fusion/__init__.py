"""Labels of several labellers made into one."""

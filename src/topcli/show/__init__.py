"""Python functions of the commands, which return results with a table, a plot and files."""

"""Python interface of the commands: functions that return results with a table, a plot, and files."""

"""Studies: the work behind the commands, such as run, compare, bench and stress."""

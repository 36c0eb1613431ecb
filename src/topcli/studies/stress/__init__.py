"""Hard cases of the tops, and trials of schemes in them."""

"""``topcli bench``: computing time against error for schemes and other integrators."""

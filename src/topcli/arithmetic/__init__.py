"""Arithmetic without physics: functions of floats that the engine compiles and that also run as plain Python."""

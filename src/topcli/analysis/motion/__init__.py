"""Class, periods, frequencies and neighbourhood of a motion from its closed form, without integrating."""

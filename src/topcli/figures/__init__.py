"""Figures: load results, then draw them."""

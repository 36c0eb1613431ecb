"""The hard cases of the tops, and how schemes fare in them."""

"""From recorded data to pictures: data first, then rendered."""

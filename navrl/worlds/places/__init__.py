"""Places that come from files: their formats, walls and furniture, and episodes in them."""

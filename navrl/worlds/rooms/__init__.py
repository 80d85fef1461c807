"""Procedural places: furnished flats and open halls."""

"""Wheels: what is put into them, and that a fresh machine needs nothing beside them."""

"""Cross bores: where a pipe was drilled through a sewer, by a head with capacitive sectors."""

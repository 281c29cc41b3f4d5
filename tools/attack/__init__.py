"""Attacks on the controller: legal commands and pin waveforms, drawn from a seed, judged by what the pins did."""

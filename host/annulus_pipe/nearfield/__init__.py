"""A near-field probe's scan of a joint, from the bench to a file."""

from annulus_pipe.nearfield.scan import Plan, Scanned, log_of, scan

__all__ = ["Plan", "Scanned", "log_of", "scan"]
